"""Spectra of concentration problems: numbers and plots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from slepian_prt.errors import UserError, check_bandlimit, check_epsilon, check_half_angle
from slepian_prt.evaluation import plots
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.slepian.shannon import (
    concentration_count,
    generalized_shannon_number,
    refined_shannon_number,
    shannon_number,
    szego_number,
)
from slepian_prt.sphere.harmonics import num_coefficients

LARGEST_BANDLIMIT = 500


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues of one problem, largest first, and the numbers that estimate how many matter.

    Attributes
    ----------
    kernel : str
    bandlimit : int
    half_angle : float
        Radians.
    epsilon : float
    eigenvalues : (K,)
        Concentrations for ``slepian``; otherwise relative to the largest.
    orders : (K,) int
    numbers : dict of str to float
        ``shannon``, ``n_g``, ``n_g_natural``, ``n_ref``, ``szego`` and the exact ``count`` of concentrations above ε of
        the plain problem; with a kernel also ``transport_count``, of eigenvalues above ε of the first, and
        ``n_ref_transport``, its estimate.
    radially_symmetric : bool
        Whether the functions are those of order 0 alone.
    """

    kernel: str
    bandlimit: int
    half_angle: float
    epsilon: float
    eigenvalues: NDArray[np.float64]
    orders: NDArray[np.int64]
    numbers: dict[str, float]
    radially_symmetric: bool = False

    @property
    def dimension(self) -> int:
        """M, how many functions there are."""
        return self.bandlimit + 1 if self.radially_symmetric else num_coefficients(self.bandlimit)

    @property
    def effective_dimension(self) -> int:
        """K, how many of them matter: the count of the problem that was solved."""
        return int(self.numbers.get("transport_count", self.numbers["count"]))

    @property
    def coherence(self) -> float:
        """1 - K/M; the paper takes K/M itself for a measure of coherence, which falls as neighbours have more alike."""
        return 1.0 - self.effective_dimension / self.dimension

    def as_dict(self) -> dict[str, Any]:
        return {
            "kernel": self.kernel,
            "bandlimit": self.bandlimit,
            "half_angle_degrees": math.degrees(self.half_angle),
            "epsilon": self.epsilon,
            "radially_symmetric": self.radially_symmetric,
            "dimension": self.dimension,
            "effective_dimension": self.effective_dimension,
            "coherence": self.coherence,
            **self.numbers,
            "orders": self.orders.tolist(),
            "eigenvalues": self.eigenvalues.tolist(),
        }


def parse_kernel(kernel: str, bandlimit: int) -> NDArray[np.float64] | None:
    """Zonal coefficients of ``diffuse`` or ``phong:EXPONENT``; None for ``slepian``.

    Raises
    ------
    UserError
        Another name, or an exponent that is not a positive number.
    """
    if not isinstance(kernel, str):
        raise UserError(f"kernel must be slepian, diffuse or phong:EXPONENT, not {kernel!r}")
    if kernel == "slepian":
        return None
    if kernel == "diffuse":
        return cosine_lobe(bandlimit)
    name, _, exponent = kernel.partition(":")
    try:
        if name == "phong":
            # Python's float takes 1_0 for 10.
            return cosine_lobe(bandlimit, math.nan if "_" in exponent else float(exponent))
    except ValueError:
        raise UserError(f"kernel phong needs a positive exponent, as in phong:128, not {exponent!r}") from None
    raise UserError(f"kernel must be slepian, diffuse or phong:EXPONENT, not {kernel!r}")


def spectrum(
    bandlimit: int,
    half_angle: float,
    kernel: str = "slepian",
    epsilon: float = 0.01,
    *,
    radially_symmetric: bool = False,
) -> Spectrum:
    """Solve one problem on a cap of ``half_angle`` radians and count."""
    bandlimit = check_bandlimit(bandlimit, largest=LARGEST_BANDLIMIT)
    half_angle, epsilon = check_half_angle(half_angle), check_epsilon(epsilon)
    zonal = parse_kernel(kernel, bandlimit)
    basis = cap_basis(bandlimit, half_angle, kernel=zonal, radially_symmetric=radially_symmetric)
    values = basis.eigenvalues
    if zonal is not None and values[0] > 0.0:
        values = values / values[0]
    cap = bandlimit, half_angle
    only = {"radially_symmetric": radially_symmetric}
    numbers = {
        "shannon": shannon_number(*cap, **only),
        "n_g": generalized_shannon_number(*cap, epsilon, **only),
        "n_g_natural": generalized_shannon_number(*cap, epsilon, log_base=math.e, **only),
        "n_ref": refined_shannon_number(*cap, epsilon, **only),
        "szego": szego_number(*cap, epsilon, kernel=zonal, **only),
        "count": float(concentration_count(*cap, epsilon, **only)),
    }
    if zonal is not None:
        numbers["n_ref_transport"] = refined_shannon_number(*cap, epsilon, kernel=zonal, **only)
        numbers["transport_count"] = float(np.sum(values > epsilon))
    return Spectrum(kernel, bandlimit, half_angle, epsilon, values, basis.orders, numbers, radially_symmetric)


def terms_to_check(result: Spectrum) -> list[int]:
    """Some K at which an error is worth a look: none, and the counts of eigenvalues above parts of the first."""
    values = result.eigenvalues
    counts = {int(np.sum(values > part * values[0])) for part in (0.5, 0.1, 0.01, 0.001)}
    return [0, *sorted(counts - {0, result.dimension})]


def draw_spectrum(axis: Any, values: NDArray, label: str, *, color: str, dash: str = "-", marker: str = "") -> None:
    """Eigenvalues against their index from one on."""
    axis.plot(np.arange(1, values.size + 1), values, dash, color=color, marker=marker, label=label, markersize=4)


def plot_spectrum(result: Spectrum) -> bytes:
    """PNG of a spectrum with its Shannon numbers, linear above and logarithmic below."""
    figure, axes = plots.make_figure(rows=2, size=(7.2, 7.0))
    upper, lower = axes[:, 0]
    reach = min(result.dimension, max(12, int(1.6 * result.numbers["count"]) + 8))
    drawn = result.eigenvalues[:reach]
    marks: list[tuple[str, str, str, Any]] = [
        ("shannon", "N", "#222222", ":"),
        ("n_g", "N_g", "#D55E00", "-."),
        ("n_ref", "N_ref", "#009E73", "--"),
        ("szego", "Szegő", "#CC79A7", (0, (1, 1))),
        ("n_ref_transport", "N_ref of the kernel's band", "#E69F00", "--"),
    ]
    if result.kernel == "slepian":  # where Szegő's number is N
        marks = marks[:3]
    for axis in (upper, lower):
        draw_spectrum(axis, drawn, result.kernel, color="#0072B2", marker="o")
        for name, symbol, color, dash in marks:
            number = result.numbers[name]
            axis.axvline(number, color=color, linestyle=dash, linewidth=1.2, label=f"{symbol} = {number:.1f}")
        axis.axhline(result.epsilon, color="#999999", linewidth=0.8)
        axis.grid(True, color="#dddddd", linewidth=0.6)
        axis.set_ylabel("eigenvalue" if result.kernel == "slepian" else "eigenvalue relative to the first")
    lower.set_yscale("log")
    lower.set_ylim(max(1e-16, 0.3 * float(drawn[drawn > 0].min(initial=1.0))), 3.0)
    lower.set_xlabel("index")
    lower.xaxis.set_major_locator(MaxNLocator(integer=True))
    upper.set_title(
        f"L = {result.bandlimit}, Θ = {math.degrees(result.half_angle):g}°"
        f"{', radially symmetric' if result.radially_symmetric else ''}: effective dimension "
        f"{result.effective_dimension} of {result.dimension} at ε = {result.epsilon:g}"
    )
    upper.legend(edgecolor="none", framealpha=0.95)
    return plots.encode_figure(figure)
