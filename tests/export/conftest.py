"""Small transfer of one channel and of three, and a light."""

import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy

BANDLIMIT = 4


@pytest.fixture(scope="session")
def packed():
    """Of a ball whose albedo varies."""
    ball = bumpy(3)
    albedo = 0.5 + 0.4 * np.sin(3.0 * ball.positions)
    mesh = make_mesh(ball.positions, ball.faces, albedo=albedo, name="ball")
    return compress(precompute(mesh, bandlimit=BANDLIMIT, samples=64, effects="direct"), tolerance=0.05, clusters=24)


@pytest.fixture(scope="session")
def coloured(packed):
    """Three channels: interreflection of a red ball and what it hides."""
    mesh = make_mesh(packed.mesh.positions, packed.mesh.faces, albedo=[0.9, 0.2, 0.1], name="red")
    transfer = precompute(mesh, bandlimit=BANDLIMIT, samples=64)
    assert transfer.vectors.shape[1] == 3
    return compress(transfer, tolerance=0.05, clusters=24)


@pytest.fixture
def light(rng):
    """Bright from above, falling as 1/(l+1)²."""
    size = (BANDLIMIT + 1) ** 2
    lighting = rng.normal(size=(3, size)) * (falling_prior(BANDLIMIT).weights ** 2)[degrees(BANDLIMIT)]
    lighting[:, 0] += 5.0
    return lighting
