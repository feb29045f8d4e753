"""Comparisons and sweeps by two workers, against the same in one process."""

from dataclasses import asdict

import numpy as np
import pytest

from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.compare import compare
from slepian_prt.evaluation.methods import METHODS, parts_of
from slepian_prt.evaluation.sweep.axes import Axes
from slepian_prt.evaluation.sweep.run import sweep
from slepian_prt.lighting.environment import make_environment
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy

pytestmark = pytest.mark.slow

# Of the errors: BLAS is asked for products of the same sizes, but a reference picture is added up in another order, and
# kernels that are compiled apart round otherwise.
RELATIVE = 1e-4


def maps():
    rng = np.random.default_rng(2)
    return [make_environment(rng.random((16, 32, 3)) ** 3, name=name) for name in ("first", "second")]


def numbers(content, but=()):
    """All numbers in nested dicts and lists, with their places; without those of some names."""
    if isinstance(content, dict):
        for name, value in content.items():
            if name not in but:
                yield from ((f"{name}/{place}", number) for place, number in numbers(value, but))
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            yield from ((f"{index}/{place}", number) for place, number in numbers(value, but))
    else:
        yield "", content


def assert_same(here, there, but):
    one, two = dict(numbers(here, but)), dict(numbers(there, but))
    assert one.keys() == two.keys()
    for place, value in one.items():
        expected = value if value is None or isinstance(value, str) else pytest.approx(value, RELATIVE, abs=1e-6)
        assert two[place] == expected, place


def test_parts_are_all_runs():
    parts = parts_of(tuple(METHODS), (4, 9))
    assert [part.method for part in parts if part.terms or part.method == "none"] == [*METHODS, "none"]
    coded = [(part.method, tolerance) for part in parts for tolerance in part.tolerances]
    assert sorted({method for method, _ in coded}) == ["adapted", "adapted+light", "cpca"]
    assert len(coded) == len(set(coded)) == 12


def test_comparisons(crew):
    options = {
        "transport": TransportSettings(bandlimit=4, samples=64),
        "grouping": CompressionSettings(clusters=8),
        "methods": ("adapted", "sh", "hsh", "d3dx", "cpca"),
        "terms": (4, 9),
        "width": 48,
        "noise": 0.05,
    }
    here, there = compare(bumpy(3), maps(), **options), compare(bumpy(3), maps(), client=crew.client, **options)
    assert_same(here.results(), there.results(), ("seconds", "compress_seconds", "relight_seconds", "versions"))
    for own, other in zip(here.views, there.views, strict=True):
        assert own.compressed.keys() == other.compressed.keys()
        np.testing.assert_allclose(
            other.reference.picture.radiance, own.reference.picture.radiance, rtol=1e-4, atol=1e-5
        )
    assert there.compressed is not None


def test_sweeps(crew, tmp_path):
    axes = Axes((16, 64), (2, 4), (8,), ("adapted", "sh"), (0.2, 0.05), (None,))
    transport = TransportSettings(4, 64, albedo=0.6)
    told = []
    options = {"noise": 0.05, "checkpoint": tmp_path / "points.jsonl"}
    here = sweep(bumpy(3), maps(), axes, transport, **options)
    there = sweep(
        bumpy(3), maps(), axes, transport, client=crew.client, advance=lambda *done: told.append(done), **options
    )
    assert len(here.points) == len(there.points) == 16
    assert told == [(1, 16)] * 16
    seconds = [name for name in asdict(here.points[0]) if name.endswith("_seconds") or name == "transport_spread"]
    points = [[asdict(point) for point in found.points] for found in (here, there)]
    assert_same(*points, seconds)
