import numpy as np
import pytest

from scripts.paper.empirical import empirical_spectrum
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.kernels import cosine_lobe


@pytest.mark.parametrize(
    ("exponent", "bandlimit", "half_angle", "reflection"),
    [(1.0, 2, 0.35, False), (1.0, 8, 0.6, False), (128.0, 10, 0.35, True), (128.0, 10, 0.7, True)],
)
def test_transport_weighted_spectrum_explains_the_empirical_one(exponent, bandlimit, half_angle, reflection):
    zonal = cosine_lobe(bandlimit, exponent)
    weighted = cap_basis(bandlimit, half_angle, kernel=zonal).eigenvalues
    plain = cap_basis(bandlimit, half_angle).eigenvalues
    samples = 20_000
    measured = empirical_spectrum(zonal, half_angle, reflection=reflection, samples=samples)
    kept = weighted > 1e-6 * weighted[0]
    ratio = measured[kept] / (weighted[kept] / weighted[0])
    # Sampling noise of a second moment of 20k points: a few times √(2/20000) = 1 %.
    np.testing.assert_allclose(ratio, 1.0, atol=0.06)
    # The paper's spectrum does not: it knows nothing of the energy in each degree.
    assert np.abs(measured[kept] / (plain[kept] / plain[0]) - 1.0).max() > 0.25
