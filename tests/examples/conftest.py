"""A model to export, and a map."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.stream import compress
from slepian_prt.lighting.projection import project_environment
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy

EXAMPLES = Path(__file__).parents[2] / "examples"

WIDTH = 64


class Case(NamedTuple):
    """Transfer, and a map in the layout of `Environment`, (H, W, 3) and as the file ``map``."""

    packed: CompressedTransfer
    texels: np.ndarray
    map: Path

    def light(self, degrees: float = 0.0) -> np.ndarray:
        """(3, M) of the map, turned about y."""
        return project_environment(self.texels, self.packed.bandlimit, rotate=degrees)


@pytest.fixture(scope="session")
def case(tmp_path_factory) -> Case:
    """A ball whose albedo varies, under a map that is smooth, so that sums over texels are exact to a thousandth."""
    ball = bumpy(3)
    mesh = make_mesh(ball.positions, ball.faces, albedo=0.5 + 0.4 * np.sin(3.0 * ball.positions), name="ball")
    packed = compress(precompute(mesh, bandlimit=5, samples=64, effects="direct"), tolerance=0.05, clusters=24)
    texels = texels_of(np.arange(WIDTH // 2) / (WIDTH // 2 - 1))
    path = tmp_path_factory.mktemp("map") / "map.hdr"
    path.write_bytes(radiance_hdr(texels))
    return Case(packed, texels, path)


def texels_of(rows: np.ndarray) -> np.ndarray:
    """(H, W, 3) of the map whose rows are at those parts of the way from the top to the bottom."""
    u = 2.0 * np.pi * (np.arange(WIDTH) + 0.5) / WIDTH
    v = np.pi * rows
    x, y, z = np.sin(v)[:, None] * np.sin(u), np.cos(v)[:, None] + 0.0 * u, -np.sin(v)[:, None] * np.cos(u)
    return np.stack([1.2 + x + 0.5 * y, 1.0 + 0.9 * z * y, 0.4 + (y + 0.3 * x) ** 2], axis=-1).astype(np.float32)


def radiance_hdr(texels: np.ndarray) -> bytes:
    """An image as Radiance writes it, not compressed; 8 bits of mantissa are shared by three colours."""
    largest = texels.max(axis=-1)
    mantissa, exponent = np.frexp(largest)
    scale = np.where(largest > 1e-32, mantissa * 256.0 / np.maximum(largest, 1e-32), 0.0)
    pixels = np.concatenate([texels * scale[..., None], (exponent + 128)[..., None]], axis=-1)
    height, width = largest.shape
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
    return header.encode() + pixels.astype(np.uint8).tobytes()
