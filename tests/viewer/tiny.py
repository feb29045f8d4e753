"""Small transfer for tests of pages: of a mesh in one or three channels, with lamps, and of a film."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import slepian_prt as sp
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.scene.film import Film, film_mesh
from slepian_prt.transport.transfer import Transfer
from tests.conftest import bumpy

WIDTH, HEIGHT = 6, 4
BANDLIMIT = 2


@cache
def traced(channels: int = 1) -> Transfer:
    """Of a bumpy ball."""
    transfer = sp.precompute(bumpy(2), bandlimit=BANDLIMIT, samples=16)
    if channels == 1:
        return transfer
    rng = np.random.default_rng(8)
    vectors = transfer.vectors * rng.uniform(0.5, 1.0, (1, 3, 1)).astype(np.float32)
    return replace(transfer, vectors=vectors + 0.01 * rng.standard_normal(vectors.shape).astype(np.float32))


@cache
def tiny(channels: int = 1) -> CompressedTransfer:
    """Of a bumpy ball, in a few caps."""
    return sp.compress(traced(channels), "none", clusters=3, coding="float32")


@cache
def lamplit() -> CompressedTransfer:
    """The same with two lamps."""
    count = len(traced().mesh.positions)
    rng = np.random.default_rng(4)
    direct, bounced = rng.random((2, 2, count, 3)).astype(np.float32)
    lamps = FixedLights(("ceiling", "desk"), ("area", "point"), np.ones((2, 3)), direct, bounced)
    return sp.compress(replace(traced(), fixed=lamps), "none", clusters=3, coding="float32")


@cache
def tiny_film(width: int = WIDTH) -> CompressedTransfer:
    """Pixels, a row of which shows what is behind."""
    rng, count = np.random.default_rng(6), width * HEIGHT
    vectors = rng.random((count, 3, (BANDLIMIT + 1) ** 2)).astype(np.float32)
    background = np.zeros((count, 3), np.float32)
    background[:width] = [1.0, 0.5, 0.25]
    directions = rng.standard_normal((2, 2, 3, 3)).astype(np.float32)
    axes = np.tile([0.0, 0.0, 1.0], (count, 1))
    noise, size = np.zeros(count, np.float32), (width, HEIGHT)
    film = Film("eye", *size, (0, 0), size, background, directions, noise, np.zeros(BANDLIMIT + 1))
    mesh = film_mesh("eye", *size, axes)
    transfer = Transfer(vectors, axes, mesh, (), BANDLIMIT, 4, 0, (), 0, 0, toward_view=True, film=film)
    return sp.compress(transfer, "none", clusters=1, coding="float32")
