import json
import math

import numpy as np
import pytest

from slepian_prt.cli import main
from slepian_prt.errors import UserError
from slepian_prt.evaluation.spectra import empirical_spectrum, parse_kernel, spectrum
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.kernels import cosine_lobe
from tests.numerics import assert_exact


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


def test_kernels_by_name():
    assert parse_kernel("slepian", 5) is None
    assert_exact(parse_kernel("diffuse", 5), cosine_lobe(5), because="the same call")
    assert_exact(parse_kernel("phong:64", 5), cosine_lobe(5, 64.0), because="the same call")
    for bad in ("phong", "phong:", "phong:x", "phong:-1", "phong:nan", "ward"):
        with pytest.raises(UserError, match=r"kernel|exponent"):
            parse_kernel(bad, 5)


def test_numbers_of_the_design():
    numbers = spectrum(10, math.radians(30), epsilon=0.01).numbers
    assert numbers["count"] == 19
    assert numbers["shannon"] == pytest.approx(121 * math.sin(math.radians(15)) ** 2)


def test_command_writes_what_it_prints(tmp_path, capsys):
    arguments = ["spectrum", "--bandlimit", "10", "--half-angle", "30", "--kernel", "phong:128"]
    assert main([*arguments, "--json", str(tmp_path / "s.json"), "--plot", str(tmp_path / "s.png")]) == 0
    assert "concentrations above 0.01: 19" in capsys.readouterr().out
    content = json.loads((tmp_path / "s.json").read_text())
    assert content["count"] == 19
    assert len(content["eigenvalues"]) == len(content["orders"]) == 121
    assert content["eigenvalues"][0] == 1.0
    assert (tmp_path / "s.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("angle", ["0", "180"])
def test_limits_have_a_spectrum_and_a_plot(angle, tmp_path):
    arguments = ["spectrum", "--bandlimit", "4", "--half-angle", angle, "--plot", str(tmp_path / "s.png")]
    assert main(arguments) == 0
    assert (tmp_path / "s.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bandlimit", "-1", "--half-angle", "10"], "bandlimit must be an integer in [0, 500], not -1"),
        (["--bandlimit", "501", "--half-angle", "10"], "bandlimit"),
        (["--bandlimit", "5", "--half-angle", "181"], "between 0 and 180 degrees, not 181"),
        (["--bandlimit", "5", "--half-angle", "nan"], "between 0 and 180 degrees"),
        (["--bandlimit", "5", "--half-angle", "10", "--epsilon", "1"], "epsilon must be"),
        (["--bandlimit", "5", "--half-angle", "10", "--kernel", "ward"], "kernel must be"),
        (["--bandlimit", "5", "--half-angle", "10", "--plot", "no/such/s.png"], "does not exist"),
        (["--bandlimit", "5", "--half-angle", "10", "--plot", "s.gif"], "written as .png"),
        (["--bandlimit", "5"], "--half-angle"),
    ],
)
def test_mistakes(arguments, message, capsys):
    assert main(["spectrum", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
