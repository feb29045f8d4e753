import json

import numpy as np
import pytest
from matplotlib.figure import Figure

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.evaluation.drawing import plot_errors, plot_picture, plot_spectrum
from tests.conftest import sphere
from tests.numerics import assert_exact


def result(coding: str, terms: float, size: float, *errors: float) -> dict:
    errors_by_name = dict(zip(("first", "second"), errors, strict=True))
    return {"basis": "sh", "coding": coding, "terms": terms, "bytes_per_vertex": size, "relit_error": errors_by_name}


RESULTS = {
    "environments": ["first", "second"],
    "methods": [
        result("float16", 9, 18.0, 0.1, 0.3),
        result("float16", 4, 8.0, 0.2, 0.6),
        result("coded", 7.5, 2.0, 0.4, 0.4),
    ],
}


def curves(ax) -> dict[str, np.ndarray]:
    return {line.get_label(): np.column_stack(line.get_data()) for line in ax.get_lines()}


def test_errors_against_bytes_and_functions(tmp_path):
    ax = Figure().subplots()
    assert plot_errors(RESULTS, ax) is ax
    assert set(curves(ax)) == {"sh", "sh, coded"}
    np.testing.assert_allclose(curves(ax)["sh"], [[8.0, 0.4], [18.0, 0.2]])  # in order, means of the environments
    (tmp_path / "results.json").write_text(json.dumps(RESULTS))
    ax = plot_errors(tmp_path / "results.json", Figure().subplots(), against="terms", environment="first")
    assert set(curves(ax)) == {"sh"}
    np.testing.assert_allclose(curves(ax)["sh"], [[4.0, 0.2], [9.0, 0.1]])


def test_results_that_are_none(tmp_path):
    (tmp_path / "text.json").write_text("no")
    for results, message in (
        (tmp_path / "no.json", "cannot be read"),
        (tmp_path / "text.json", "is not JSON"),
        ({"environments": []}, "no results of a comparison"),
        ([], "no results of a comparison"),
    ):
        with pytest.raises(UserError, match=message):
            plot_errors(results, Figure().subplots())
    with pytest.raises(UserError, match="environment must be one of first, second"):
        plot_errors(RESULTS, Figure().subplots(), environment="third")
    with pytest.raises(UserError, match="against must be one of bytes, terms"):
        plot_errors(RESULTS, Figure().subplots(), against="time")


def test_a_spectrum():
    basis = sp.cap_basis(6, 0.7)
    ax = plot_spectrum(basis, Figure().subplots(), label="cap")
    np.testing.assert_allclose(curves(ax)["cap"][:, 1], basis.eigenvalues)
    np.testing.assert_allclose(curves(ax)["cap"][:, 0], np.arange(1, 50))


def test_a_picture():
    transfer = sp.precompute(sphere(1), bandlimit=1, samples=16)
    light = np.zeros((3, 4))
    light[:, 0] = 1.0
    ax = plot_picture(transfer, light, Figure().subplots(), width=20, background="white")
    shown = ax.get_images()[0].get_array()
    assert_exact(shown, sp.render_picture(transfer, light, width=20, background="white"), "the same computation")


def test_new_axes_where_none_are_given():
    import matplotlib.pyplot as plt

    ax = plot_spectrum(sp.cap_basis(3, 0.7))
    assert ax.figure.number in plt.get_fignums()
    plt.close(ax.figure)
