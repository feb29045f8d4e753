import json
import math
import os
import subprocess
import sys

import pytest

from slepian_prt.cli import main
from slepian_prt.cli.spectrum import _identity_row
from slepian_prt.errors import UserError
from slepian_prt.evaluation import spectra
from slepian_prt.evaluation.error_identity import IdentityRow
from slepian_prt.evaluation.spectra import parse_kernel, spectrum, terms_to_check
from slepian_prt.slepian.kernels import cosine_lobe
from tests.numerics import assert_exact


def test_kernels_by_name():
    assert parse_kernel("slepian", 5) is None
    assert_exact(parse_kernel("diffuse", 5), cosine_lobe(5), because="the same call")
    assert_exact(parse_kernel("phong:64", 5), cosine_lobe(5, 64.0), because="the same call")
    for bad in ("phong", "phong:", "phong:x", "phong:-1", "phong:nan", "phong:1_0", "ward", None, 3):
        with pytest.raises(UserError, match=r"kernel|exponent"):
            parse_kernel(bad, 5)


def test_numbers_of_the_design():
    numbers = spectrum(10, math.radians(30), epsilon=0.01).numbers
    assert numbers["count"] == 19
    assert numbers["shannon"] == pytest.approx(121 * math.sin(math.radians(15)) ** 2)


def test_numbers_of_radially_symmetric_functions():
    # The cases: counts at ε = 0.01, the paper's number, which is far too large, and the one that fits.
    for bandlimit, degrees, count, n_g in ((10, 10, 1, 5.4), (10, 20, 2, 9.4), (50, 20, 7, 24.6), (100, 60, 35, 69.7)):
        result = spectrum(bandlimit, math.radians(degrees), radially_symmetric=True)
        assert result.numbers["count"] == result.effective_dimension == count
        assert result.numbers["n_g"] == pytest.approx(n_g, abs=0.05)
        assert round(result.numbers["n_ref"]) == count
        assert result.dimension == result.eigenvalues.size == bandlimit + 1
        assert set(result.orders) == {0}


def test_effective_dimension_is_that_of_the_problem():
    plain, diffuse = (spectrum(10, math.radians(30), kernel) for kernel in ("slepian", "diffuse"))
    assert plain.effective_dimension == plain.numbers["count"] == diffuse.numbers["count"] == 19
    assert plain.coherence == pytest.approx(1 - 19 / 121)
    assert diffuse.effective_dimension == diffuse.numbers["transport_count"] == (diffuse.eigenvalues > 0.01).sum()
    assert diffuse.effective_dimension < 19
    assert plain.numbers["szego"] == pytest.approx(plain.numbers["shannon"], rel=1e-14)
    assert diffuse.numbers["szego"] == pytest.approx(9 * math.sin(math.radians(15)) ** 2)


def test_terms_to_check():
    result = spectrum(10, math.radians(30))
    assert terms_to_check(result) == [0, 8, 12, 19, 23]
    assert terms_to_check(spectrum(3, math.pi)) == [0]  # all functions have no error


def test_command_writes_what_it_prints(tmp_path, capsys):
    arguments = ["spectrum", "--bandlimit", "10", "--half-angle", "30", "--kernel", "phong:128"]
    assert main([*arguments, "--json", str(tmp_path / "s.json"), "--plot", str(tmp_path / "s.png")]) == 0
    printed = capsys.readouterr().out
    assert "concentrations above 0.01: 19" in printed
    assert "eigenvalues of transport above 0.01 of the first: 17" in printed
    assert "effective dimension 17 of 121, coherence 0.86" in printed
    content = json.loads((tmp_path / "s.json").read_text())
    assert content["count"] == 19
    assert content["effective_dimension"] == content["transport_count"] == 17
    assert len(content["eigenvalues"]) == len(content["orders"]) == 121
    assert content["eigenvalues"][0] == 1.0
    assert (tmp_path / "s.png").read_bytes()[:4] == b"\x89PNG"


def test_szegos_number_is_told_of_a_kernel_alone(tmp_path, capsys):
    # Without one it is N once more.
    path = tmp_path / "s.json"
    for kernel, lines in (("slepian", 0), ("diffuse", 1)):
        arguments = ["spectrum", "--bandlimit", "4", "--half-angle", "30", "--kernel", kernel, "--json", str(path)]
        assert main(arguments) == 0
        assert capsys.readouterr().out.count("Szeg") == lines
        assert json.loads(path.read_text())["szego"] > 0.0


def test_json_of_the_smallest_epsilon(tmp_path):
    path = tmp_path / "s.json"

    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    for radial in ([], ["--radial"]):
        arguments = ["spectrum", "--bandlimit", "5", "--half-angle", "10", "--epsilon", "1e-320", "--json", str(path)]
        assert main([*arguments, *radial]) == 0
        assert json.loads(path.read_text(), parse_constant=refuse)["n_ref"] > 0.0
    row = _identity_row(IdentityRow(3, 1e-30, 0.0))
    assert json.dumps(row, allow_nan=False).endswith('"difference": null}')


@pytest.mark.parametrize("kernel", ["slepian", "diffuse"])
@pytest.mark.parametrize("radial", [False, True])
def test_command_checks_the_error_identity(kernel, radial, tmp_path, capsys):
    arguments = ["spectrum", "--bandlimit", "6", "--half-angle", "40", "--kernel", kernel, "--check"]
    arguments += ["--json", str(tmp_path / "s.json"), *(["--radial"] if radial else [])]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert ("7 radially symmetric functions" if radial else "49 functions") in printed
    rows = json.loads((tmp_path / "s.json").read_text())["error_identity"]
    assert len(rows) >= 2
    for row in rows:
        assert row["difference"] < 1e-10
        assert f"{row['quadrature']:.7g}" in printed


@pytest.mark.parametrize("radial", [[], ["--radial"]])
@pytest.mark.parametrize("angle", ["0", "180"])
def test_limits_have_a_spectrum_and_a_plot(angle, radial, tmp_path):
    arguments = ["spectrum", "--bandlimit", "4", "--half-angle", angle, "--plot", str(tmp_path / "s.png")]
    assert main([*arguments, *radial]) == 0
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
        (["--bandlimit", "5", "--half-angle", "10", "--plot", "s.png", "--json", "./s.png"], "must be two files"),
        (["--bandlimit", "5"], "--half-angle"),
        (["--bandlimit", "51", "--half-angle", "10", "--check"], "--bandlimit must be at most 50 for the error"),
        (["--bandlimit", "5", "--half-angle", "0", "--check"], "--half-angle must be above 0 for the error"),
    ],
)
def test_mistakes(arguments, message, capsys):
    assert main(["spectrum", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error


def test_what_cannot_be_checked_is_refused_before_anything_is_solved(monkeypatch, capsys):
    monkeypatch.setattr(spectra, "spectrum", None)
    assert main(["spectrum", "--bandlimit", "51", "--half-angle", "20", "--check"]) == 2
    assert "bandlimit must be at most 50 for the error to be checked" in capsys.readouterr().err


def test_files_are_written_though_nobody_reads_what_is_printed(tmp_path):
    command = [sys.executable, "-m", "slepian_prt", "spectrum", "--bandlimit", "4", "--half-angle", "30", "--json"]
    reading, writing = os.pipe()
    os.close(reading)
    subprocess.run([*command, str(tmp_path / "s.json")], check=False, stdout=writing, stderr=subprocess.DEVNULL)
    os.close(writing)
    assert len(json.loads((tmp_path / "s.json").read_text())["eigenvalues"]) == 25


def test_eigenvalues_that_are_rounding_are_not_told(capsys):
    """mpmath has 2.9e-36 and 4.7e-43 for the last two, which came out as 7.9e-34 and 2e-32."""
    assert main(["spectrum", "--bandlimit", "10", "--half-angle", "20", "--radial"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2:] == 2 * ["  below 1e-28  (m = +0)"]
    assert "e-" in lines[-3]
