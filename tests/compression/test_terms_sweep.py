"""Numbers of terms that share their bases, against each compressed by itself."""

import numpy as np
import pytest

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.terms_sweep import compress_to_terms
from slepian_prt.errors import UserError
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy
from tests.numerics import assert_exact


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(3), bandlimit=5, samples=128)


@pytest.mark.parametrize(("basis", "refine"), [("adapted", None), ("sh", None), ("pca", None), ("adapted", True)])
def test_the_same_as_alone(basis, refine, shadowed):
    settings = CompressionSettings(basis=basis, clusters=8, coding="float16", refine=refine)
    grouping = group_transfer(settings, shadowed)
    for k, packed in zip((9, 4), compress_to_terms(shadowed, settings, grouping, (9, 4)), strict=True):
        alone = compress(shadowed, basis, terms=k, clusters=grouping, coding="float16", refine=refine)
        assert packed.terms == alone.terms == k
        assert_exact(packed.reconstruct(), alone.reconstruct(), "the same work on the same numbers")
        assert packed.seconds["compress"] > 0.0


def test_bases_count_in_the_seconds_of_each(shadowed, monkeypatch):
    clock = iter(np.arange(0.0, 100.0, 5.0))  # each look at the clock is five seconds after the last
    monkeypatch.setattr("time.perf_counter", lambda: float(next(clock)))
    settings = CompressionSettings(basis="sh", clusters=8, coding="float16")
    grouping = group_transfer(settings, shadowed)
    found = [packed.seconds["compress"] for packed in compress_to_terms(shadowed, settings, grouping, (4, 9, 16))]
    assert found == [10.0, 10.0, 10.0]  # five of learning, five of what is done for each


def test_refused(shadowed):
    settings = CompressionSettings(basis="sh", clusters=8, coding="float16")
    with pytest.raises(UserError, match="terms"):
        next(compress_to_terms(shadowed, settings, group_transfer(settings, shadowed), (37,)))
    with pytest.raises(ValueError, match="cpca"):
        next(compress_to_terms(shadowed, CompressionSettings(basis="cpca"), group_transfer(settings, shadowed), (4,)))
