"""Partial occlusion, as Fig. 4 of Lessig & Fiume."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from drawing import COLORS, save
from paper import pit

import slepian_prt as sp


def paper_figure_4() -> None:
    """Fig. 4 of the paper, partial occlusion: the floor of a hemispherical pit under radially symmetric light.

    Spectrum of Eq. 9 (radially symmetric Slepian functions, C = 4(L+1)Θ) against that of exact transport, by
    integration over the open disk, and of ray-traced transport.
    """
    figure, (sketch, axis) = plt.subplots(1, 2, figsize=(12, 4.8), width_ratios=(1, 1.6))
    arc = np.linspace(-np.pi / 2, np.pi / 2, 181)
    sketch.plot(np.sin(arc), -np.cos(arc), color="#555555", linewidth=2)
    part = np.linspace(-np.radians(20), np.radians(20), 41)
    sketch.plot(np.sin(part), -np.cos(part), color=COLORS[0], linewidth=5)
    sketch.text(0.0, -1.15, "floor: normals within Θ", color=COLORS[0], ha="center")
    for x in (-1.0, 1.0):
        sketch.plot([0, x], [-1, 0], color="#999999", linestyle=":")
    sketch.annotate("", (0, 0.1), (0, -0.5), arrowprops={"arrowstyle": "->"})
    sketch.text(0.04, -0.25, "h")
    sketch.text(0, 0.2, "light, symmetric about h", ha="center")
    sketch.set_ylim(-1.3, 0.4)
    sketch.set_aspect("equal")
    sketch.axis("off")
    bandlimit, worst = 10, 0.0
    for color, angle in zip(COLORS, (5, 10, 20, 40), strict=True):
        angles = np.linspace(0.0, math.radians(angle), 41)
        plain = sp.cap_basis(bandlimit, angles[-1], radially_symmetric=True).eigenvalues
        exact = pit.pit_spectrum(pit.exact_pit_transfer(bandlimit, angles), angles)
        traced = pit.pit_spectrum(pit.traced_pit_transfer(bandlimit, angles), angles)
        kept = exact > 1e-7
        worst = max(worst, float(np.abs(traced[: kept.size][kept] / exact[kept] - 1).max()))
        index = np.arange(1, bandlimit + 2)
        axis.plot(index, plain / plain[0], "-", color=color, label=f"Θ = {angle}°")
        axis.plot(index, exact, "--", color=color)
        axis.plot(index, traced, "o", color=color, fillstyle="none", markersize=5)
        number = sp.generalized_shannon_number(bandlimit, angles[-1], 0.01, radially_symmetric=True)
        axis.axvline(number, color=color, linestyle="-.", linewidth=1)
    axis.plot([], [], "k-", label="Slepian, Eq. 9")
    axis.plot([], [], "k--", label="exact transport in the pit")
    axis.plot([], [], "ko", fillstyle="none", label="ray-traced")
    axis.plot([], [], "k-.", linewidth=1, label="N_g(0.01), C = 4(L+1)Θ")
    axis.set_yscale("log")
    axis.set_ylim(1e-12, 3)
    axis.set_xlim(0.8, 11.5)
    axis.set_title("L = 10")
    axis.set_xlabel("index")
    axis.set_ylabel("eigenvalue relative to the first")
    axis.grid(True, color="#dddddd", linewidth=0.6)
    axis.legend(frameon=False, fontsize=9, loc="upper right", bbox_to_anchor=(1.36, 1.0))
    print(f"ray-traced against exact: at most {worst:.1%} apart down to 1e-7 of the first")
    save(figure, "paper_figure_4")
