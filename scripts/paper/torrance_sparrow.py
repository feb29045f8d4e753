"""Radial symmetry of rough conductors' lobes (Lessig & Fiume, Sec. 4, after Ramamoorthi & Hanrahan 2004)."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from drawing import COLORS, save
from paper.lobe_symmetry import best_symmetry, falls_below, lobe_toward, symmetric_part

from slepian_prt.renderer.variants import mitsuba

ALPHAS = (0.1, 0.3, 0.5)
DISTRIBUTIONS = ("beckmann", "ggx")
ANGLES = np.arange(0.0, 81.0, 5.0)
LEAST = 0.95


def torrance_sparrow() -> None:
    """Part of the lobe of Mitsuba's roughconductor that is radially symmetric, at outgoing angles up to 80°."""
    figure, axes = plt.subplots(2, 1, figsize=(7.2, 8.0), sharex=True, sharey=True, gridspec_kw={"hspace": 0.18})
    print("| distribution | α | below 95 % about the reflection direction | about the best axis | at 80°, of either |")
    print("| --- | --- | --- | --- | --- |")
    with mitsuba() as mi:
        for axis, distribution in zip(axes, DISTRIBUTIONS, strict=True):
            for alpha, color in zip(ALPHAS, COLORS, strict=False):
                bsdf = mi.load_dict(
                    {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": distribution}
                )
                lobes = [lobe_toward(mi, bsdf, math.radians(angle)) for angle in ANGLES]
                pairs = list(zip(lobes, np.radians(ANGLES), strict=True))
                mirror = np.array([symmetric_part(lobe, angle).part for lobe, angle in pairs])
                best = np.array([best_symmetry(lobe, angle).part for lobe, angle in pairs])
                axis.plot(ANGLES, 100 * best, "-", color=color, label=f"α = {alpha:g}, best axis")
                axis.plot(ANGLES, 100 * mirror, "--", color=color, label=f"α = {alpha:g}, reflection direction")
                told = " | ".join(_told(falls_below(ANGLES, parts, LEAST)) for parts in (mirror, best))
                print(f"| {distribution} | {alpha:g} | {told} | {mirror[-1]:.0%}, {best[-1]:.0%} |")
            axis.axhline(100 * LEAST, color="#555555", linewidth=0.8, linestyle=":")
            axis.set(title=distribution, ylabel="energy that is symmetric, %", ylim=(0, 102))
            axis.grid(True, color="#dddddd", linewidth=0.6)
    axes[-1].set(xlabel="outgoing angle, degrees from the normal", xticks=range(0, 81, 10))
    axes[0].legend(frameon=False, fontsize=10, loc="lower left")
    save(figure, "torrance_sparrow")


def _told(angle: float | None) -> str:
    return f"above {ANGLES[-1]:.0f}°" if angle is None else f"from {angle:.0f}°"
