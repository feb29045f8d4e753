import json
import math

import pytest

from slepian_prt.cli import main
from slepian_prt.errors import UserError
from slepian_prt.evaluation.spectra import parse_kernel, spectrum
from slepian_prt.slepian.kernels import cosine_lobe
from tests.numerics import assert_exact


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
