import math

import numpy as np
import pytest

from slepian_prt.compression.codec import models
from slepian_prt.compression.codec.contexts import (
    RAREST_SHARE,
    WIDTHS,
    stored_shares,
    told_counts,
    width_frequencies,
    widths_of,
)
from slepian_prt.compression.codec.models import ESCAPE, TOKENS, WHOLE
from tests.numerics import assert_exact


def test_models_are_distributions_and_ordered():
    table = models.frequencies()
    assert (table.sum(axis=1) == WHOLE).all()
    assert (table[:, 0] > 0).all()
    assert (table[:, ESCAPE] > 0).all()
    means = models.mean_magnitudes().reshape(3, -1)
    assert (np.diff(means, axis=1)[:, 2:] > 0).all()


def test_models_are_those_of_the_formula():
    """In float64, where that is good enough: within the rounding to whole parts."""
    lowest = models.lowest_of(np.arange(TOKENS)).astype(float)
    lowest[ESCAPE] = 131086
    for i, odds in ((10, 1.0), (24 + 56, 0.5), (40 + 112, 2.0)):
        decay = [16.0 / 2.0 ** ((i % 56) / 4) / size for size in (0.6, 1.0, 2.0)]
        tail = sum(p * np.exp(-d * (lowest - 0.5)) for p, d in zip((0.4, 0.4, 0.2), decay, strict=True))
        tail[0] = 1.0
        tail[1] = sum(p * math.exp(-0.64 * d) for p, d in zip((0.4, 0.4, 0.2), decay, strict=True))
        other = 1.0 / (1.0 + odds * (1.0 - tail[1]) / tail[1])
        expected = np.append(1.0 - other, -np.diff(tail[1:]) / tail[1] * other)
        found = models.frequencies()[i, :ESCAPE] / WHOLE
        kept = expected * WHOLE >= 1.0
        largest = expected.argmax()
        assert np.abs(found - expected)[kept & (np.arange(ESCAPE) != largest)].max() <= 0.5 / WHOLE + 1e-12
        # The largest takes what rounding the others left.
        assert abs(found[largest] - expected[largest]) <= 0.5 * TOKENS / WHOLE


def test_tokens_and_what_follows_tell_every_magnitude():
    magnitudes = np.r_[0:70_000, 131_000:131_200, 2**24, 2**31]
    tokens = models.plain_tokens(magnitudes)
    rest = magnitudes - models.lowest_of(tokens)
    assert (rest >= 0).all()
    assert (rest < 1 << models.extra_bits_of(tokens)).all()
    assert (tokens[magnitudes < 131_086] < ESCAPE).all()
    assert (tokens[magnitudes >= 131_086] == ESCAPE).all()
    quiet = models.tokens_of(magnitudes, np.zeros(magnitudes.size, dtype=int))
    assert (quiet[5:] == ESCAPE).all()


@pytest.mark.parametrize(("per_octave", "first", "count"), [(4, -8, 17), (2, -19, 40), (8, -96, 97)])
def test_roots_of_two_are_right(per_octave, first, count):
    found = models.power_parts(first, count, per_octave)
    np.testing.assert_allclose(found, 2.0 ** (np.arange(first, first + count) / per_octave), rtol=3e-16)


def test_widths_reach_just_what_they_have_to():
    for count in range(41):
        reached = told_counts(widths_of(np.array([count])), np.array([40]))[0]
        assert count <= reached <= min(max(2 * count - 1, 0), 40)


def test_tables_of_widths_are_distributions(rng):
    seen = rng.integers(0, 1000, size=(7, WIDTHS)) * rng.integers(0, 2, size=(7, WIDTHS))
    seen[:, 3] += 1
    parts = width_frequencies(stored_shares(seen.astype(float)))
    assert (parts > 0).all()
    assert (parts.sum(axis=1) == WHOLE).all()
    shares = seen / seen.sum(axis=1, keepdims=True)
    # Stored in eighths of an octave: within 2^(1/16), and a part for each that was not seen.
    large = shares > 0.02
    np.testing.assert_allclose(parts[large] / WHOLE, shares[large], rtol=0.15)
    assert_exact(width_frequencies(np.full((1, WIDTHS), RAREST_SHARE, np.uint8)).min(), 256, because="integers")
