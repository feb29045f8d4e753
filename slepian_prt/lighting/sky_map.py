"""A sky with its sun on the texels of a map, for what needs texels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.sky import MAP_TO_SKY, Evaluate, SkyQuadrature, sun_disk
from slepian_prt.lighting.texel_projection import clenshaw_curtis

# Rows; and the points of the disk that fall on each texel, each way.
_ROWS, _POINTS = 512, 2


def sky_texels(quadrature: SkyQuadrature, samples: NDArray[np.float64], evaluate: Evaluate) -> NDArray[np.float64]:
    """(512, 1024, 3) texels, the map's up axis the zenith, so that the horizon lies between two rows.

    The power of the sun's disk, and its centroid, are those of the quadrature: each of its points is spread on the
    four texels around by bilinear weights.

    Parameters
    ----------
    quadrature : SkyQuadrature
    samples : (N, 3)
        Radiance in its directions.
    evaluate : callable
        Gives radiance (n, 3) in directions (n, 3) of the world.
    """
    height, width = _ROWS, 2 * _ROWS
    theta = np.pi * np.arange(height // 2) / (height - 1)
    u = 2.0 * np.pi * (np.arange(width) + 0.5) / width
    towards = [np.outer(np.sin(theta), np.sin(u)), np.outer(np.cos(theta), np.ones(width)),
               np.outer(np.sin(theta), -np.cos(u))]  # fmt: skip
    directions = np.stack([axis.ravel() for axis in towards], axis=1) @ MAP_TO_SKY.T
    sun, frame = quadrature.sun, quadrature.frame
    if sun is not None:
        directions = sun.beside(directions)
    texels = np.zeros((height, width, 3))
    texels[: height // 2] = evaluate(directions @ frame.T).reshape(height // 2, width, 3)
    if sun is None:
        return texels
    step = np.pi / (height - 1)
    radii = max(12, math.ceil(_POINTS * sun.half_angle / step))
    azimuths = max(24, math.ceil(2.0 * np.pi * _POINTS * sun.half_angle / step))
    disk = sun_disk(sun, radii, azimuths, lambda local: evaluate(local @ frame.T))
    above = evaluate(disk.evaluated @ frame.T) - evaluate(sun.beside(disk.directions) @ frame.T)
    flux = above * disk.solid_angles[:, None]
    wanted = quadrature.disk_flux(samples).sum(axis=0)
    found = flux.sum(axis=0)
    flux *= np.divide(wanted, found, out=np.ones(3), where=found != 0.0)
    _add_points(texels, disk.directions @ MAP_TO_SKY, flux)
    return texels


def _add_points(texels: NDArray[np.float64], directions: NDArray[np.float64], flux: NDArray[np.float64]) -> None:
    """Add what comes from directions (n, 3) of the map, as irradiance (n, 3), to the texels around them."""
    height, width = texels.shape[:2]
    row = np.arccos(np.clip(directions[:, 1], -1.0, 1.0)) / np.pi * (height - 1)
    column = np.arctan2(directions[:, 0], -directions[:, 2]) / (2.0 * np.pi) * width - 0.5
    top, left = np.minimum(row.astype(int), height - 2), np.floor(column).astype(int)
    down, right = row - top, column - left
    solid_angles = clenshaw_curtis(height - 1) * (2.0 * np.pi / width)
    for rows, row_weight in ((top, 1.0 - down), (top + 1, down)):
        for columns, column_weight in ((left, 1.0 - right), (left + 1, right)):
            share = row_weight * column_weight / solid_angles[rows]
            np.add.at(texels, (rows, columns % width), share[:, None] * flux)
