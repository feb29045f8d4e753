"""Meshes as pages draw them: the same triangles, coded in few bytes."""

from __future__ import annotations

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.relighting.files.surfaces import split_surfaces
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part
from slepian_prt.viewer.buffers import Buffers
from slepian_prt.viewer.drawn_mesh import draw_mesh
from tests.conftest import bumpy
from tests.numerics import assert_exact
from tests.viewer.page_reader import with_arrays

SHEET = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def entry_of(drawn, first_texture: int = 0):
    """What a reader gets of it."""
    buffers = Buffers()
    entry = drawn.entry(buffers, first_texture)
    return with_arrays(entry, buffers.content())


def two_sided():
    """A square with a back, and one beside it."""
    beside = SHEET + [3.0, 0, 0]
    mesh = make_mesh(np.vstack([SHEET, SHEET, beside]), np.vstack([FACES, FACES[:, ::-1] + 4, FACES + 8]))
    return mesh, (Part("sheet", 0, 4, sides=2), Part("beside", 8, 4))


def detail_of(mesh, chosen: list[int], uv) -> SurfaceDetail:
    """Textures on some faces; reflectance is a half there."""
    count = len(mesh.faces)
    textures = (Texture("a", b"a"), Texture("b", b"b", ("clamp", "mirror")))
    none = np.full(count, -1, np.int32)
    colors = np.full((count, 3, 3), 0.5, np.float32)
    no_metal = np.zeros(count, np.float32)
    return SurfaceDetail(textures, np.array(chosen, np.int32), uv, colors, no_metal, none, np.zeros_like(uv))


def triangles(positions: np.ndarray, faces: np.ndarray) -> list:
    """The corners of triangles, sorted; each begins with its least corner, the same way round."""
    rounded = [[tuple(np.round(point, 3)) for point in corners] for corners in positions[faces]]
    turned = [corners[k:] + corners[:k] for corners in rounded for k in [corners.index(min(corners))]]
    return sorted(turned)


def test_the_same_triangles_in_another_order():
    mesh = bumpy(2)
    shuffled = make_mesh(mesh.positions, np.random.default_rng(3).permutation(mesh.faces))
    drawn = draw_mesh(shuffled, (Part("ball", 0, len(mesh.positions)),), split_surfaces(shuffled, _one(shuffled)))
    entry = entry_of(drawn)
    positions = entry["positions"] + entry["center"]
    extent = np.ptp(mesh.positions, axis=0).max()
    # Half a step of 65,535 to the largest side.
    np.testing.assert_allclose(positions, mesh.positions[drawn.receivers], atol=0.51 * extent / 65535)
    assert triangles(positions, entry["faces"].reshape(-1, 3)) == triangles(mesh.positions, mesh.faces)
    assert entry["faceCount"] == len(mesh.faces)
    assert entry["vertexCount"] == entry["receiverCount"] == len(mesh.positions)
    assert entry["receivers"] is None
    assert entry["reflectance"] is None
    assert entry["uv"] is None


def _one(mesh) -> tuple[Part, ...]:
    return (Part("all", 0, len(mesh.positions)),)


def test_vertices_stand_as_faces_name_them():
    mesh = bumpy(2)
    drawn = draw_mesh(mesh, _one(mesh), split_surfaces(mesh, _one(mesh)))
    first = np.maximum.accumulate(drawn.faces.ravel())
    assert_exact(np.unique(np.diff(first)), [0, 1], "each new number follows the largest before")


def test_backs_are_told_from_fronts():
    mesh, parts = two_sided()
    drawn = draw_mesh(mesh, parts, split_surfaces(mesh, parts))
    assert [(one.name, one.size, one.back) for one in drawn.surfaces] == [
        ("sheet", 2, False), ("sheet", 2, True), ("beside", 2, False)
    ]  # fmt: skip
    back = drawn.receivers[drawn.faces[2:4]]
    assert np.all((back >= 4) & (back < 8))


def test_a_seam_has_its_vertices_twice_and_counts_them_once():
    mesh, parts = make_mesh(SHEET, FACES), (Part("sheet", 0, 4),)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[3, 0], [4, 1], [3, 1]]], np.float32)
    drawn = draw_mesh(mesh, parts, split_surfaces(mesh, parts, detail_of(mesh, [0, 0], uv)))
    entry = entry_of(drawn, first_texture=5)
    assert entry["vertexCount"] == 6
    assert entry["receiverCount"] == 4
    numbers = entry["receivers"].ravel()
    assert_exact(numbers[entry["faces"].reshape(2, 3)], [[0, 1, 2], [0, 2, 3]], "whole numbers")
    # A step of 2⁻²² of the range.
    np.testing.assert_allclose(entry["uv"][entry["faces"].reshape(2, 3)], uv, atol=4.0 / 2**22)
    np.testing.assert_allclose(entry["reflectance"] / 65535, 0.5, atol=0.5 / 65535)
    assert [one["texture"] for one in entry["surfaces"]] == [5]


def test_textures_are_carried_once_and_in_order():
    mesh, parts = two_sided()
    uv = np.zeros((6, 3, 2), np.float32)
    drawn = draw_mesh(mesh, parts, split_surfaces(mesh, parts, detail_of(mesh, [1, 1, 1, 1, -1, -1], uv)))
    assert [texture.name for texture in drawn.textures] == ["b"]
    assert [one.texture for one in drawn.surfaces] == [0, 0, None]


def test_something_small_beside_something_large_keeps_its_shape():
    ball = bumpy(2)
    floor = 2000.0 * SHEET + [0.0, 0.0, -2.0]
    positions = np.vstack([ball.positions, floor])
    mesh = make_mesh(positions, np.vstack([ball.faces, FACES + len(ball.positions)]))
    parts = (Part("ball", 0, len(ball.positions)), Part("floor", len(ball.positions), 4))
    drawn = draw_mesh(mesh, parts, split_surfaces(mesh, parts))
    entry = entry_of(drawn)
    error = np.abs(entry["positions"] + entry["center"] - positions[drawn.receivers]).max()
    assert error <= 0.51 * 4000.0 / 65535 / 2**7  # as many halvings as its mean edge asks for
    assert (
        error < np.linalg.norm(ball.positions[ball.faces[:, 0]] - ball.positions[ball.faces[:, 1]], axis=1).mean() / 30
    )


def test_nothing_to_draw_is_told():
    mesh, parts = two_sided()
    with pytest.raises(UserError, match="has no faces, so there is nothing to draw"):
        draw_mesh(mesh, parts, ())
