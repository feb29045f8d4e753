"""A mesh split by parts and textures covers every face once, with what it reflects."""

import numpy as np

from slepian_prt.relighting.files.surfaces import split_surfaces
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part
from tests.numerics import assert_exact

GRID = 4


def strips(rng: np.random.Generator) -> Mesh:
    """A grid of squares, of an albedo of its own at each vertex."""
    x, y = np.meshgrid(np.arange(GRID + 1.0), np.arange(GRID + 1.0))
    positions = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    first = (np.arange(GRID) + (GRID + 1) * np.arange(GRID)[:, None]).ravel()
    near, far = first, first + GRID + 1
    faces = np.concatenate([np.stack([near, near + 1, far + 1], 1), np.stack([near, far + 1, far], 1)])
    return make_mesh(positions, faces, albedo=rng.uniform(0.1, 0.9, positions.shape))


def detail_of(mesh: Mesh, choice: np.ndarray, rng: np.random.Generator) -> SurfaceDetail:
    count = len(mesh.faces)
    return SurfaceDetail(
        (Texture("a", b"a"), Texture("b", b"b")),
        choice.astype(np.int32),
        rng.uniform(-1.0, 2.0, (count, 3, 2)).astype(np.float32),
        rng.uniform(0.2, 1.4, (count, 3, 3)).astype(np.float32),
        np.where(np.arange(count) % 2, 0.5, 0.0).astype(np.float32),
        np.where(np.arange(count) == 3, 1, -1).astype(np.int32),
        np.zeros((count, 3, 2), dtype=np.float32),
    )


def test_without_textures_there_is_a_surface_for_each_part(rng):
    mesh = strips(rng)
    other = make_mesh(mesh.positions + [0.0, 0.0, 3.0], mesh.faces)
    count = len(mesh.positions)
    both = make_mesh(
        np.vstack([mesh.positions, other.positions]),
        np.vstack([mesh.faces, other.faces + count]),
        albedo=np.vstack([mesh.albedo, other.albedo]),
    )
    surfaces = split_surfaces(both, (Part("low", 0, count), Part("high", count, count)))
    assert [surface.name for surface in surfaces] == ["low", "high"]
    for surface, faces in zip(surfaces, (mesh.faces, mesh.faces + count), strict=True):
        assert surface.texture is None
        assert surface.uv is None
        assert_exact(surface.vertices[surface.faces], faces, "integers")
        assert_exact(surface.reflectance, both.albedo[surface.vertices], "copies")


def test_textures_cover_their_faces_and_no_other(rng):
    """A face whose metal has a texture of its own is left with the albedo of its vertices."""
    mesh = strips(rng)
    choice = np.arange(len(mesh.faces)) % 3 - 1
    detail = detail_of(mesh, choice, rng)
    surfaces = split_surfaces(mesh, (Part("one", 0, len(mesh.positions)),), detail)
    chosen = np.where(np.arange(len(choice)) == 3, -1, choice)
    assert [surface.texture for surface in surfaces] == [None, *detail.textures]
    for surface, number in zip(surfaces, (-1, 0, 1), strict=True):
        faces = np.flatnonzero(chosen == number)
        assert_exact(surface.vertices[surface.faces], mesh.faces[faces], "integers")
        assert surface.faces.max() == len(surface.vertices) - 1
        if number < 0:
            assert_exact(surface.reflectance, mesh.albedo[surface.vertices], "copies")
            continue
        assert_exact(surface.uv[surface.faces], detail.uv[faces], "copies")
        diffuse = detail.colors[faces] * (1.0 - detail.metallic[faces])[:, None, None]
        assert_exact(surface.reflectance[surface.faces], np.clip(diffuse, 0.0, 1.0), "copies, cut at one")
