"""Files of PIFu and ICON, read by a reader of our own, with values from their definition."""

import io

import numpy as np
import pytest

from slepian_prt.datasets.training_files import as_npy, fixed_point, icon_files, pifu_files, their_transfer
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from tests.conftest import random_directions
from tests.datasets.obj_as_theirs import read_icon, read_pifu, their_harmonics
from tests.numerics import assert_exact

FACES = np.array([[0, 1, 2], [2, 1, 0]])


def write(folder, files):
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def test_transfer_is_theirs(rng):
    """∫ (n·ω)₊ Y(ω) dω with their harmonics and vectors, on a product grid that is exact for the polynomials in it.

    The clamped cosine is none, but over the hemisphere about its normal it is: the grid is turned there.
    """
    normals = random_directions(rng, 5)
    ours = zonal_vectors(cosine_lobe(2), normals)
    x, weights = np.polynomial.legendre.leggauss(8)
    height, weights = 0.5 * (x + 1.0), 0.5 * weights
    turn = np.arange(16) * 2.0 * np.pi / 16
    z, a = np.repeat(height, 16), np.tile(turn, 8)
    local = np.stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z], axis=1)
    weight = np.repeat(weights, 16) * 2.0 * np.pi / 16
    for normal, vector in zip(normals, ours, strict=True):
        side = np.linalg.qr(np.stack([normal, *np.eye(3)[:2]], axis=1))[0]
        frame = np.stack([side[:, 1], np.cross(normal, side[:, 1]), normal], axis=1)
        direction = local @ frame.T
        theta, phi = np.arccos(direction[:, 2]), np.arctan2(-direction[:, 1], -direction[:, 0])
        expected = (weight * z) @ their_harmonics(theta, phi)
        np.testing.assert_allclose(their_transfer(vector[None].astype(np.float32))[0], expected, rtol=0.0, atol=1e-6)


def test_text_is_read_back(rng):
    """To half a unit of the eighth decimal, as numpy.savetxt would write it."""
    numbers = np.concatenate(
        [rng.uniform(-3.5, 3.5, (50, 9)), [[0.0, -0.0, 1.0, -1.0, 9.99999999, -1e-9, 1e-8, 0.1, 3]]]
    )
    text = fixed_point(numbers)
    np.testing.assert_allclose(np.loadtxt(io.BytesIO(text)), numbers, rtol=0.0, atol=0.5e-8 + 1e-15)
    written = io.BytesIO()
    np.savetxt(written, numbers, fmt="%.8f")
    differ = [
        (ours, theirs)
        for ours, theirs in zip(text.split(), written.getvalue().split(), strict=True)
        if ours != theirs and ours != b"0.00000000"
    ]
    assert len(differ) <= 1  # halves may go either way


@pytest.mark.parametrize(
    ("name", "folder"), [("anna", "anna"), ("rp_dennis_posed_004_100k", "rp_dennis_posed_004_OBJ"), ("_100k", "_OBJ")]
)
def test_files_of_pifu(name, folder, tmp_path, rng):
    """Where apps/render_data.py looks for them beside the scan, order 2 in 64 bits, faces as they are."""
    vectors = rng.uniform(-1.0, 1.0, (3, 9)).astype(np.float32)
    write(tmp_path, pifu_files(name, vectors, FACES))
    table, faces = read_pifu(tmp_path / folder)
    np.testing.assert_allclose(table, their_transfer(vectors), rtol=0.0, atol=0.5e-8 + 1e-15)
    assert table.dtype == np.float64
    assert_exact(faces, FACES, "as given")
    assert faces.dtype == np.int64


def test_files_of_icon(tmp_path, rng):
    """In 64 bits: their renderer hands the bytes to OpenGL as GL_DOUBLE."""
    vectors = rng.uniform(-1.0, 1.0, (3, 9)).astype(np.float32)
    write(tmp_path, icon_files("0123", vectors, FACES))
    table, faces = read_icon(tmp_path / "0123")
    assert_exact(table, their_transfer(vectors), "as given")
    assert table.dtype == np.float64
    assert_exact(faces, FACES, "as given")
    assert faces.dtype == np.int64


def test_arrays_hold_no_objects():
    assert np.load(io.BytesIO(as_npy(FACES)), allow_pickle=False).shape == FACES.shape
