"""What results print: one line, and a table in notebooks."""

from dataclasses import replace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.environment import make_environment
from slepian_prt.summary import summary_line, summary_table
from tests.conftest import sphere


def test_what_is_none_is_left_out():
    entries = {"name": "a <b>", "vertices": 12345, "error": 0.0123456, "turned": None, "coded": True}
    assert summary_line("Thing", entries) == "Thing(name='a <b>', vertices=12345, error=0.01235, coded=True)"
    table = summary_table("Thing", {**entries, "rays_traced": 7})
    for text in ("a &lt;b&gt;", "12,345", "0.01235", "yes", "rays traced"):
        assert text in table
    assert "turned" not in table
    assert table.count("<tr>") == 5


@pytest.fixture(scope="module")
def results():
    """Results, and how their lines begin."""
    ball = replace(sphere(2), name="ball", notes=("2 faces turned",))
    return {
        "Mesh(name='ball', vertices=162, faces=320, size='2 x 2 x 2', albedo='1', notes='2 faces turned')": ball,
        "Environment(name='studio', texels='8 x 4', brightest=2.5, turned='90°')": make_environment(
            np.full((4, 8, 3), 2.5), name="studio"
        ).rotated(90.0),
        "Transfer(source='ball', vertices=162, bandlimit=3, channels=1, samples=16, effects='none', bounces=0, "
        "rays_traced=0, seconds=": sp.precompute(ball, bandlimit=3, samples=16, effects="none"),
        "CompressedTransfer(source='ball', vertices=162, bandlimit=3, channels=1, basis='sh', terms=4, caps=96, "
        "coding='float16', bytes_per_vertex=": sp.compress(
            sp.precompute(ball, bandlimit=3, samples=16), "sh", terms=4, coding="float16"
        ),
        "CapBasis(bandlimit=3, half_angle=0.5, center='0, 0, 1', functions='4 of 16', eigenvalues='": sp.cap_basis(
            3, 0.5, terms=4
        ),
        "RegionBasis(bandlimit=2, functions='9 of 9', eigenvalues='": sp.region_basis(2, sp.cap_region([0, 0, 1], 0.5)),
    }


def test_results_are_one_short_line(results):
    for start, result in results.items():
        line = repr(result)
        assert line.startswith(start)
        assert "\n" not in line
        assert len(line) < 250
    assert "albedo='0.5, 0.5, 1'" in repr(sp.make_mesh(np.eye(3), [[0, 1, 2]], albedo=[0.5, 0.5, 1.0]))
    assert repr(sp.SecondMoment(1, (np.ones((2, 1)), np.ones((1, 1))))) == "SecondMoment(bandlimit=1, energy=4)"


def test_notebooks_show_a_table(results):
    for result in results.values():
        table = result._repr_html_()
        assert table.startswith(f"<table><caption>{type(result).__name__}</caption>")
        assert table.endswith("</table>")
