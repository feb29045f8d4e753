"""Coefficients of pixels as channels of an OpenEXR file, as another reader finds them."""

import numpy as np
import OpenEXR
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.coefficient_layers import channel_names, write_coefficients
from tests.numerics import assert_exact


def test_names_of_channels():
    names = channel_names(10)
    assert len(names) == len(set(names)) == 363
    assert names[:4] == ["l00.m+00.R", "l00.m+00.G", "l00.m+00.B", "l01.m-01.R"]
    assert names[-1] == "l10.m+10.B"


@pytest.mark.parametrize("channels", [1, 3])
def test_another_reader_finds_them(channels, rng, tmp_path):
    width, height, bandlimit = 5, 4, 2
    vectors = rng.normal(size=(width * height, channels, 9)).astype(np.float32)
    background = rng.random((width * height, 3), dtype=np.float32)
    write_coefficients(tmp_path / "picture.exr", vectors, background, width, height)
    with OpenEXR.File(str(tmp_path / "picture.exr"), separate_channels=True) as file:
        found = {name: channel.pixels for name, channel in file.channels().items()}
    assert set(found) == {*channel_names(bandlimit), *(f"background.{colour}" for colour in "RGB")}
    for l in range(bandlimit + 1):
        for m in range(-l, l + 1):
            for c, colour in enumerate("RGB"):
                stored = found[f"l{l:02d}.m{m:+03d}.{colour}"]
                wanted = vectors[:, c % channels, l * l + l + m].reshape(height, width)
                assert_exact(stored, wanted, "float32 as it is")
    assert_exact(found["background.G"], background[:, 1].reshape(height, width), "float32 as it is")


def test_other_kinds_of_files_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"written as \.exr"):
        write_coefficients(tmp_path / "picture.png", np.zeros((1, 3, 1)), np.zeros((1, 3)), 1, 1)
