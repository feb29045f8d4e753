"""What may be asked of a capture, and how samples are divided into passes."""

import math

import pytest

from slepian_prt.errors import UserError
from slepian_prt.transport.capturing.settings import CaptureSettings


@pytest.mark.parametrize("samples", [2, 3, 16, 63, 64, 100, 255, 256, 1000, 4096, 65536])
def test_passes_are_grids_of_at_least_what_is_asked_for(samples):
    settings = CaptureSettings(samples=samples)
    count, total = settings.per_pass, settings.per_pass * settings.passes
    rows = math.isqrt(count)
    assert rows * -(-count // rows) == count  # as `multijitter` lays them out, without rounding up
    assert samples <= total <= 1.2 * samples + 4
    assert settings.passes >= 2


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"samples": 1}, r"samples must be an integer in \[2, 65536\], not 1"),
        ({"samples": 64, "max_error": 0.1}, "leave out `max_error` and `max_seconds`"),
        ({"max_error": 0.0}, r"max_error must be a number in \(0, 1\), not 0.0"),
        ({"max_error": "small"}, r"max_error must be a number in \(0, 1\), not 'small'"),
        ({"max_seconds": -1}, "max_seconds must be a positive number, not -1"),
        ({"max_seconds": math.inf}, "max_seconds must be a positive number, not inf"),
        ({"bandlimit": 51}, r"bandlimit must be an integer in \[0, 50\], not 51"),
        ({"seed": -1}, "seed must be a non-negative integer, not -1"),
    ],
)
def test_numbers_out_of_range(asked, told):
    with pytest.raises(UserError, match=told):
        CaptureSettings(**asked)
