"""The table of tools: which harmonics they hold, in which order, times what, in which arrays.

Each row says what the numbers of a tool are beside ours (orthonormal, Condon–Shortley phase, transfer with 1/π):
theirs = factor × ours. ``docs/coming-from.md`` shows the same table, and a test holds the two together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.conventions.layouts import COLOURS_FIRST, COLOURS_LAST, PROPERTIES, ROWS, TRIANGLES, Layout
from slepian_prt.sphere.harmonics import degrees, orders

TRANSFER, LIGHTING, FUNCTION = "transfer", "lighting", "function"

# What numbers may be: of a receiver; of light; of any function on the sphere.
QUANTITIES = (TRANSFER, LIGHTING, FUNCTION)


@dataclass(frozen=True)
class Factor:
    """What our coefficients are multiplied by.

    Attributes
    ----------
    text : str
        For the reader.
    of : callable
        Given degrees and orders, (n²,) each, the factors.
    """

    text: str
    of: Callable[[NDArray, NDArray], NDArray]

    def __call__(self, bandlimit: int) -> NDArray[np.float64]:
        """(n²,) in our order."""
        l, m = degrees(bandlimit), orders(bandlimit)
        return np.asarray(self.of(l, m) * np.ones(l.size), dtype=np.float64)


@dataclass(frozen=True)
class Form:
    """How a tool holds one kind of numbers.

    Attributes
    ----------
    factor : Factor
    layout : Layout
    offset : float
        Added to a function besides what its coefficients say: the colour of a splat is 0.5 where they are zero.
    """

    factor: Factor
    layout: Layout
    offset: float = 0.0


@dataclass(frozen=True)
class Neighbour:
    """A tool.

    Attributes
    ----------
    tool : str
    forms : dict of str to Form
        By the quantities that it has.
    lowest, highest : int, int or None
        Bandlimits that it can hold.
    sequence : tuple of (l, m) or None
        Its order of the harmonics, where that is not l² + l + m.
    map_turn : float
        Degrees about y, counter-clockwise from above, from where we put a map to where it does.
    """

    tool: str
    forms: Mapping[str, Form]
    lowest: int = 0
    highest: int | None = None
    sequence: tuple[tuple[int, int], ...] | None = None
    map_turn: float = 0.0

    @property
    def bandlimits(self) -> str:
        """For the reader."""
        if self.highest is None:
            return "any"
        return str(self.highest) if self.lowest == self.highest else f"{self.lowest} to {self.highest}"

    def permutation(self, bandlimit: int) -> NDArray[np.int64]:
        """(n²,) where in our order each of its numbers stands."""
        if self.sequence is None:
            return np.arange((bandlimit + 1) ** 2)
        return np.array([l * l + l + m for l, m in self.sequence])


def _sign(m: NDArray) -> NDArray:
    return np.where(m % 2, -1.0, 1.0)


def _clamped_cosine(l: NDArray) -> NDArray:
    """A_l of degrees 0 to 2, those that these tools have (Ramamoorthi & Hanrahan 2001, whose are π times as large)."""
    return np.array([1.0, 2.0 / 3.0, 0.25])[l]


def _polynomial(l: NDArray, m: NDArray) -> NDArray:
    """K_lm: y_lm = (−1)^m K_lm q with q = 1, y, z, x, xy, yz, 3z² − 1, xz, x² − y²."""
    squares = np.array([1.0, 3.0, 3.0, 3.0, 15.0, 15.0, 1.25, 15.0, 3.75])
    return np.sqrt(squares / (4.0 * math.pi))[l * l + l + m]


SAME = Factor("1", lambda l, m: np.ones(l.size))
SIGN = Factor("(−1)^m", lambda l, m: _sign(m))
PI = Factor("π", lambda l, m: np.full(l.size, math.pi))
PI_SIGN = Factor("π (−1)^m", lambda l, m: math.pi * _sign(m))
FOUR_PI = Factor("(−1)^m / √(4π)", lambda l, m: _sign(m) / math.sqrt(4.0 * math.pi))
IRRADIANCE = Factor("π A_l", lambda l, m: math.pi * _clamped_cosine(l))
SHADER = Factor("A_l K_lm (−1)^m", lambda l, m: _clamped_cosine(l) * _polynomial(l, m) * _sign(m))
SHADING = Factor("(−1)^m, over π for l ≥ 1", lambda l, m: _sign(m) / np.where(l > 0, math.pi, 1.0))


def _any(factor: Factor, layout: Layout, *quantities: str, offset: float = 0.0) -> dict[str, Form]:
    form = Form(factor, layout, offset)
    return dict.fromkeys(quantities, form)


OURS = "slepian_prt"

NEIGHBOURS: Mapping[str, Neighbour] = {
    OURS: Neighbour("this package, drjit.sh_eval", _any(SAME, ROWS, *QUANTITIES)),
    "d3dx": Neighbour("D3DX, D3DXSHEvalDirection", _any(SAME, COLOURS_FIRST, LIGHTING), 1, 5),
    "pifu": Neighbour(
        "PIFu and ICON, prt_util, env_sh.npy",
        {TRANSFER: Form(PI_SIGN, ROWS), LIGHTING: Form(SIGN, COLOURS_LAST)},
    ),
    "three": Neighbour(
        "three.js, LightProbe, SphericalHarmonics3", _any(SIGN, COLOURS_LAST, LIGHTING, FUNCTION), 2, 2,
        map_turn=90.0,
    ),
    "filament": Neighbour("Filament, sh of cmgen", _any(SAME, COLOURS_LAST, LIGHTING, FUNCTION)),
    "filament-irradiance": Neighbour(
        "Filament, sh-irradiance of cmgen", _any(IRRADIANCE, COLOURS_LAST, LIGHTING), 0, 2
    ),
    "filament-shader": Neighbour("Filament, sh-shader of cmgen", _any(SHADER, COLOURS_LAST, LIGHTING), 2, 2),
    "games202": Neighbour(
        "GAMES202, transport.txt, light.txt",
        {TRANSFER: Form(PI, ROWS), LIGHTING: Form(SAME, COLOURS_LAST)}, 2, 2,
    ),
    "google": Neighbour("Google spherical-harmonics", _any(SAME, ROWS, LIGHTING, FUNCTION)),
    "deca": Neighbour(
        "DECA and FLAME, add_SHlight", _any(SHADING, COLOURS_LAST, LIGHTING), 2, 2,
        sequence=((0, 0), (1, 1), (1, -1), (1, 0), (2, -2), (2, 1), (2, -1), (2, 2), (2, 0)),
    ),
    "shtools": Neighbour(
        "SHTOOLS, pyshtools: 4pi, csphase=1, real", _any(FOUR_PI, TRIANGLES, LIGHTING, FUNCTION)
    ),
    "sphericart": Neighbour("sphericart", _any(SIGN, ROWS, LIGHTING, FUNCTION)),
    "gaussian-splatting": Neighbour(
        "3D gaussian splatting, f_dc, f_rest of a .ply", _any(SAME, PROPERTIES, FUNCTION, offset=0.5), 0, 3
    ),
    "khr-gaussian-splatting": Neighbour(
        "glTF, KHR_gaussian_splatting", _any(SAME, COLOURS_LAST, FUNCTION, offset=0.5), 0, 3
    ),
}  # fmt: skip
