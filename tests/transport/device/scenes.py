"""A scene in which every kind of receiver is."""

import numpy as np

from slepian_prt.scene.mesh import Mesh, make_mesh
from tests.conftest import bumpy


def all_kinds() -> Mesh:
    """A bumpy ball above a floor that goes through a box, a closed box with its faces inward, and a loose vertex."""
    ball = bumpy(3)
    grid = np.stack(np.meshgrid(np.linspace(-3, 3, 13), [-1.6], np.linspace(-3, 3, 13), indexing="ij"), -1)
    floor = grid.reshape(-1, 3)
    row, column = (part.ravel() for part in np.meshgrid(np.arange(12), np.arange(12), indexing="ij"))
    corner = 13 * row + column
    faces = [
        np.stack([corner, corner + 1, corner + 13], axis=1),
        np.stack([corner + 1, corner + 14, corner + 13], axis=1),
    ]
    parts = [(ball.positions, ball.faces), (floor, np.concatenate(faces))]
    for place, size, inward in [((2.2, -1.6, 2.2), 0.5, False), ((9.0, 0.0, 0.0), 1.0, True)]:
        corners = np.array(place) + size * (np.array(np.unravel_index(np.arange(8), (2, 2, 2))).T - 0.5)
        sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        triangles = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
        parts.append((corners, triangles[:, ::-1] if inward else triangles))
    parts.append((np.array([[0.0, 5.0, 0.0]]), np.zeros((0, 3), dtype=np.int64)))
    begins = np.cumsum([0, *(len(positions) for positions, _ in parts)])
    positions = np.concatenate([positions for positions, _ in parts])
    faces = np.concatenate([begin + faces for begin, (_, faces) in zip(begins, parts, strict=False)])
    return make_mesh(positions, faces, name="all kinds")
