"""Which parts of a model are said to be inside out."""

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.orientation import parts_inside_out


def ball(at=(0.0, 0.0, 0.0), radius: float = 1.0, *, inward: bool = False) -> tuple[np.ndarray, np.ndarray]:
    shape = trimesh.creation.icosphere(1, radius)
    return shape.vertices + at, shape.faces[:, ::-1] if inward else shape.faces


def hard_cube(at=(0.0, 0.0, 0.0), size: float = 1.0, *, inward: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """24 vertices: no two sides share any."""
    box = trimesh.creation.box((size, size, size))
    box.unmerge_vertices()
    return box.vertices + at, box.faces[:, ::-1] if inward else box.faces


def sheet(at=(0.0, 0.0, 0.0), *, inward: bool = False) -> tuple[np.ndarray, np.ndarray]:
    p = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]) + at
    f = np.array([[0, 1, 2], [0, 2, 3]])
    return p, f[:, ::-1] if inward else f


def together(*shapes, normals=None, loose: int = 0):
    starts = np.cumsum([0, *(len(p) for p, _ in shapes)])
    p = np.concatenate([*(p for p, _ in shapes), np.full((loose, 3), 99.0)])
    return make_mesh(p, np.concatenate([f + s for (_, f), s in zip(shapes, starts, strict=False)]), normals=normals)


def said(mesh) -> list[str]:
    return [note for note in mesh.notes if "inside out" in note]


@pytest.mark.parametrize("loose", [0, 3])
@pytest.mark.parametrize("make", [ball, hard_cube])
def test_one_of_three_is_named_with_its_place(make, loose):
    mesh = together(make((-5, 0, 0)), make((0, 4, 0.5), inward=True), make((5, 0, 0)), loose=loose)
    count = 42 if make is ball else 36
    assert said(mesh) == [
        f"a closed part is inside out among others that are not ({count} vertices about 0, 4, 0.5) and will be dark; "
        "turn its faces round"
    ]


def test_two_of_three_are_counted():
    mesh = together(ball((-5, 0, 0), inward=True), ball((0, 4, 0)), ball((5, 0, 0), inward=True))
    (note,) = said(mesh)
    assert note.startswith(
        "2 closed parts are inside out among others that are not (the first of 42 vertices about -5,"
    )
    assert note.endswith("turn their faces round")


def test_each_part_is_given_by_its_vertices():
    mesh = together(ball((-5, 0, 0)), hard_cube((0, 4, 0), inward=True))
    (wrong,) = parts_inside_out(mesh.positions, mesh.normals, mesh.faces)
    assert sorted(wrong) == list(range(42, 42 + 36))


@pytest.mark.parametrize(
    "shapes",
    [
        (ball(radius=2.0), ball(inward=True), ball((9, 0, 0))),  # a hollow ball beside another
        (hard_cube(size=2.0), hard_cube(inward=True)),
        (hard_cube(size=8.0, inward=True),),  # a room
        (hard_cube(size=8.0, inward=True), ball((1, 0, 0)), hard_cube((-1, 0, 0))),  # with furniture
        (ball(inward=True), ball((4, 0, 0), inward=True)),  # all of them: seen from inside, or a matter of convention
        (ball(), sheet((3, 0, 0)), sheet((5, 0, 0), inward=True)),  # sheets have no inside
        (ball(), sheet((3, 0, 0))),
    ],
    ids=["cavity", "hard cavity", "room", "furnished room", "all", "sheets", "one closed"],
)
def test_what_is_right_is_not_remarked_on(shapes):
    assert not said(together(*shapes))


def test_normals_tell_the_side_whatever_the_winding():
    """Faces that run the other way with outward normals are right; outward faces with inward normals are not."""
    shapes = ball((-5, 0, 0)), ball((5, 0, 0))
    outward = np.concatenate([p - p.mean(axis=0) for p, _ in shapes])
    turned = np.repeat([1.0, -1.0], 42)[:, None]
    assert not said(together(shapes[0], (shapes[1][0], shapes[1][1][:, ::-1]), normals=outward))
    assert "about 5, " in said(together(*shapes, normals=turned * outward))[0]


def test_a_mirrored_part_whose_winding_turned_is_named():
    p, f = ball((5, 0, 0))
    assert said(together(ball(), hard_cube((0, 5, 0)), (p * [-1, 1, 1], f)))


def test_many_parts(rng):
    """A hundred of ten thousand."""
    p, f = hard_cube()
    at = np.stack(np.meshgrid(*[np.arange(0.0, 22.0)] * 3), axis=-1).reshape(-1, 1, 3)[:10000] * 2.0
    inward = np.zeros(len(at), dtype=bool)
    inward[rng.choice(len(at), 100, replace=False)] = True
    faces = np.where(inward[:, None, None], f[:, ::-1], f) + (len(p) * np.arange(len(at)))[:, None, None]
    normals = np.where(inward[:, None], -1.0, 1.0)[:, :, None] * p
    found = parts_inside_out((p + at).reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3))
    assert [int(part[0]) // len(p) for part in found] == np.flatnonzero(inward).tolist()
