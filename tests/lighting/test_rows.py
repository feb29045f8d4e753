"""Rows of maps: on the poles here and in Mitsuba, at centres elsewhere; and what that makes of the same texels."""

import math

import numpy as np
import pytest

import slepian_prt as sp


def with_rows_at_centres(texels, bandlimit):
    """(3, M) of texels (H, 2H, 3) that each fill a cell about ((r + ½)/H, (c + ½)/2H), as most tools have them."""
    height, width = texels.shape[:2]
    polar = math.pi * (np.arange(height) + 0.5) / height
    azimuth = 2.0 * math.pi * (np.arange(width) + 0.5) / width
    d = np.stack(
        [
            np.outer(np.sin(polar), np.sin(azimuth)),
            np.repeat(np.cos(polar)[:, None], width, axis=1),
            -np.outer(np.sin(polar), np.cos(azimuth)),
        ],
        axis=-1,
    )
    edges = np.cos(math.pi * np.arange(height + 1) / height)
    area = np.repeat((edges[:-1] - edges[1:]) * 2.0 * math.pi / width, width)
    return texels.reshape(-1, 3).T @ (sp.real_sh(bandlimit, d.reshape(-1, 3)) * area[:, None])


@pytest.mark.parametrize(
    ("height", "bandlimit", "difference"),
    [
        pytest.param(256, 2, 0.0037, marks=pytest.mark.slow),
        (64, 2, 0.0147),
        (16, 2, 0.051),
        pytest.param(256, 10, 0.0142, marks=pytest.mark.slow),
        (64, 10, 0.056),
        (16, 10, 0.28),
    ],
)
def test_the_same_texels_are_other_light(height, bandlimit, difference):
    """The figures of docs/conventions.md, on the shipped sky, made smaller by means of texels."""
    sky = np.asarray(sp.read_environment(sp.example("sky")).texels, dtype=np.float64)
    k = len(sky) // height
    texels = sky.reshape(height, k, 2 * height, k, 3).mean(axis=(1, 3)).astype(np.float32)
    ours, theirs = sp.project_environment(texels, bandlimit), with_rows_at_centres(texels, bandlimit)
    assert np.linalg.norm(theirs - ours) / np.linalg.norm(ours) == pytest.approx(difference, rel=0.02)
