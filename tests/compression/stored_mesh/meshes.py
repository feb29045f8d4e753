"""Meshes that are hard to store, and what they must have in common with what is read again."""

from __future__ import annotations

from collections import Counter

import numpy as np

from slepian_prt.compression.stored_mesh.stored import StoredMesh, read_mesh, store_mesh
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.two_sides import with_back
from slepian_prt.scene.normals import angle_weighted_normals
from slepian_prt.scene.scene import Part


def mesh_of(positions, faces, normals=None, albedo=None) -> Mesh:
    """Without any of the checks that readers of files make."""
    positions, faces = np.array(positions, dtype=np.float64), np.array(faces, dtype=np.int32).reshape(-1, 3)
    normals = angle_weighted_normals(positions, faces) if normals is None else normals
    white = np.ones((len(positions), 3), dtype=np.float32)
    return Mesh("mesh", positions, normals, faces, white if albedo is None else albedo)


def soup(rng: np.random.Generator, vertices: int = 40, faces: int = 90, places: int = 4) -> Mesh:
    """Few places, many vertices at each, and any three of them as a face: nothing is a manifold, much is repeated."""
    positions = rng.integers(0, places, (vertices, 3)) * 0.37 - 1.0
    corners = rng.integers(0, max(vertices - 5, 1), (faces, 3))
    corners = np.concatenate([corners, corners[: faces // 5], corners[: faces // 7, [1, 2, 0]], corners[:3, ::-1]])
    return mesh_of(positions, corners)


def whole(mesh: Mesh) -> tuple[Part, ...]:
    return (Part(mesh.name, 0, len(mesh.positions)),)


def both_sides(mesh: Mesh) -> tuple[Mesh, tuple[Part, ...]]:
    rng = np.random.default_rng(1)
    back = with_back(mesh, rng.random(mesh.albedo.shape).astype(np.float32))
    return back, (Part(mesh.name, 0, len(mesh.positions), 2),)


def joined(*meshes: tuple[Mesh, tuple[Part, ...]]) -> tuple[Mesh, tuple[Part, ...]]:
    """Meshes as the parts of one scene."""
    first, parts, faces = 0, [], []
    for mesh, own in meshes:
        parts += [Part(f"{len(parts)}", first + part.first, part.count, part.sides) for part in own]
        faces.append(mesh.faces + first)
        first += len(mesh.positions)
    columns = ([getattr(mesh, name) for mesh, _ in meshes] for name in ("positions", "normals", "albedo"))
    positions, normals, albedo = (np.concatenate(column) for column in columns)
    return Mesh("scene", positions, normals, np.concatenate(faces).astype(np.int32), albedo), tuple(parts)


def cycles(faces: np.ndarray) -> Counter:
    """Faces with their orientation, whichever corner comes first."""
    return Counter(min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in faces.tolist())


def stored_and_read(mesh: Mesh, parts: tuple[Part, ...], *, exact: bool = False) -> tuple[StoredMesh, Mesh]:
    """What is stored; whatever it is, vertices and faces are those of the mesh."""
    stored = store_mesh(mesh, parts, exact=exact)
    read = read_mesh(stored.entry, stored.arrays, "mesh", ())
    order = stored.order
    assert sorted(order.tolist()) == list(range(len(mesh.positions)))
    for part in parts:
        for side in range(part.sides):
            block = range(part.first + side * part.count, part.first + (side + 1) * part.count)
            assert sorted(order[block].tolist()) == list(block)
        if part.sides == 2:  # the back of a vertex is the same number of vertices later
            assert np.all(
                order[part.first + part.count : part.end] == order[part.first : part.first + part.count] + part.count
            )
    assert cycles(order[read.faces]) == cycles(mesh.faces)
    for name in ("positions", "normals", "albedo"):
        ours, theirs = getattr(stored.mesh, name)[order], getattr(read, name)
        assert ours.dtype == theirs.dtype
        assert ours.tobytes() == theirs.tobytes(), name
    assert stored.mesh.faces is mesh.faces
    return stored, read


def turned_by(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) degrees between unit vectors, 180 where just one of them is zero."""
    apart = np.degrees(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(a - b, axis=1), 1.0)))
    return np.where(a.any(axis=1) == b.any(axis=1), apart, 180.0)
