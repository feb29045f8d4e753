"""Spectra of the concentration problem, and its first functions."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from drawing import COLORS, save
from paper.empirical import empirical_spectrum

import slepian_prt as sp
from slepian_prt.evaluation import spectra

# Down to which concentration functions count, in the paper's Figs. 2 to 4.
EPSILON = 0.01


def paper_figure_2() -> None:
    """Spectra of the concentration problem, as Fig. 2 of Lessig & Fiume: L = 5 and 20, several caps, N and N_g."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6))
    for axis, bandlimit, half_angles in ((axes[0], 5, (10, 20, 30, 60)), (axes[1], 20, (5, 10, 20, 30))):
        for color, angle in zip(COLORS, half_angles, strict=True):
            result = spectra.spectrum(bandlimit, math.radians(angle), epsilon=EPSILON)
            spectra.draw_spectrum(axis, result.eigenvalues, f"Θ = {angle}°", color=color)
            _mark_numbers(axis, bandlimit, math.radians(angle), color)
        # From 0 on: N is 0.27 at L = 5, Θ = 10°.
        axis.set_xlim(0.0, min((bandlimit + 1) ** 2, 60 if bandlimit == 20 else 36))
        axis.set_xlabel("index")
        axis.set_ylabel("concentration λ")
        axis.grid(True, color="#dddddd", linewidth=0.6)
        title = f"L = {bandlimit};  dotted N, dash-dotted N_g({EPSILON:g})"
        axis.legend(
            frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, handlelength=1.4, title=title
        )
    save(figure, "paper_figure_2")


def _mark_numbers(axis: plt.Axes, bandlimit: int, half_angle: float, color: str) -> None:
    """Lines at N, dotted, and N_g, dash-dotted, as in the paper."""
    generalised = sp.generalized_shannon_number(bandlimit, half_angle, EPSILON)
    axis.axvline(sp.shannon_number(bandlimit, half_angle), color=color, linestyle=":", linewidth=1.4)
    axis.axvline(generalised, color=color, linestyle="-.", linewidth=1.0)


def paper_figure_3() -> None:
    """Fig. 3 of the paper, and what explains the difference that it leaves: the transport-weighted spectrum.

    Left, diffuse transport at L = 2. Right, Phong with exponent 128 at L = 10, whose axis is the reflection
    direction: normals in a cap Θ make axes in a cap 2Θ. Lines at N and N_g as in the paper; on the level ε the
    estimates that know the kernel: triangles by Szegő's theorem, diamonds N_ref of the kernel's band.
    """
    figure, axes = plt.subplots(1, 2, figsize=(12, 5.2))
    diffuse = "diffuse, L = 2", 2, 1.0, (10, 20, 40), False, 9
    phong = "Phong 128, L = 10, normals within Θ", 10, 128.0, (5, 10, 20), True, 60
    worst = max(_transport_spectra(axis, *case) for axis, case in zip(axes, (diffuse, phong), strict=True))
    axis = axes[0]
    axis.plot([], [], "k-", label="Slepian (the paper)")
    axis.plot([], [], "k--", label="transport-weighted (ours)")
    axis.plot([], [], "ko", fillstyle="none", label="SVD of an empirical operator")
    axis.plot([], [], "k:", label="N")
    axis.plot([], [], "k-.", linewidth=1.0, label="N_g(0.01)")
    axis.plot([], [], "kv", label="Szegő, after Mahajan et al.")
    axis.plot([], [], "kD", markersize=5, label="N_ref of the kernel's band")
    figure.legend(*axis.get_legend_handles_labels(), loc="upper center", ncols=5, frameon=False, fontsize=9)
    figure.subplots_adjust(top=0.86)
    axes[1].legend(frameon=False, fontsize=9, loc="upper right")
    print(f"transport-weighted against empirical: at most {10**worst - 1:.0%} apart down to 1e-8 of the first")
    save(figure, "paper_figure_3")


def _transport_spectra(
    axis: plt.Axes, title: str, bandlimit: int, exponent: float, angles: tuple[int, ...], reflection: bool, reach: int
) -> float:
    """Draw one half of Fig. 3; how far weighted and empirical spectra are apart at most, in decades."""
    zonal, worst = sp.cosine_lobe(bandlimit, exponent), 0.0
    for color, angle in zip(COLORS, angles, strict=False):
        half_angle = math.radians(angle * (2 if reflection else 1))
        plain = sp.cap_basis(bandlimit, half_angle).eigenvalues
        weighted = sp.cap_basis(bandlimit, half_angle, kernel=zonal).eigenvalues
        measured = empirical_spectrum(zonal, half_angle, reflection=reflection)
        weighted = weighted / weighted[0]
        kept = (weighted > 1e-8)[: measured.size]
        worst = max(worst, float(np.abs(np.log10(measured[kept] / weighted[: measured.size][kept])).max()))
        spectra.draw_spectrum(axis, plain[:reach] / plain[0], f"Θ = {angle}°", color=color)
        spectra.draw_spectrum(axis, weighted[:reach], "", color=color, dash="--")
        axis.plot(np.arange(1, reach + 1), measured[:reach], "o", color=color, markersize=4, fillstyle="none")
        _mark_numbers(axis, bandlimit, half_angle, color)
        szego = sp.szego_number(bandlimit, half_angle, EPSILON, kernel=zonal)
        refined = sp.refined_shannon_number(bandlimit, half_angle, EPSILON, kernel=zonal)
        axis.plot(szego, EPSILON, "v", color=color, markersize=9, clip_on=False, zorder=5)
        axis.plot(refined, EPSILON, "D", color=color, markersize=6, zorder=5)
    axis.axhline(EPSILON, color="#999999", linewidth=0.8)
    axis.set_yscale("log")
    axis.set_ylim(1e-9, 2.0)
    axis.set_xlim(0.0, reach + 0.5)
    axis.set_title(title)
    axis.set_xlabel("index")
    axis.set_ylabel("eigenvalue relative to the first")
    axis.grid(True, color="#dddddd", linewidth=0.6)
    return worst


def functions() -> None:
    """Maps of the first functions of a cap of 40° at L = 10: plain, and weighted by diffuse transport."""
    bandlimit, half_angle, count, size = 10, math.radians(40), 8, 161
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    inside = x * x + y * y < 1
    # Lambert's equal-area azimuthal projection of the whole sphere, the cap in the middle.
    rho = np.sqrt(x[inside] ** 2 + y[inside] ** 2)
    theta, phi = 2 * np.arcsin(rho), np.arctan2(y[inside], x[inside])
    d = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    harmonics = sp.real_sh(bandlimit, d)
    figure, axes = plt.subplots(2, count, figsize=(1.7 * count, 4.1))
    kernels = (("Slepian", None), ("diffuse transport", sp.cosine_lobe(bandlimit)))
    for row, (name, kernel) in zip(axes, kernels, strict=True):
        basis = sp.cap_basis(bandlimit, half_angle, kernel=kernel)
        for i, axis in enumerate(row):
            image = np.full(x.shape, np.nan)
            image[inside] = harmonics @ basis.functions[:, i]
            largest = np.nanmax(np.abs(image))
            axis.imshow(image, cmap="RdBu_r", vmin=-largest, vmax=largest, extent=(-1, 1, -1, 1))
            axis.add_patch(plt.Circle((0, 0), math.sin(half_angle / 2), fill=False, color="black", linewidth=0.8))
            axis.add_patch(plt.Circle((0, 0), 1, fill=False, color="#999999", linewidth=0.8))
            value = basis.eigenvalues[i] / (basis.eigenvalues[0] if kernel is not None else 1.0)
            axis.set_title(f"m = {basis.orders[i]:+d}, {value:.3g}", fontsize=9)
            axis.axis("off")
        row[0].text(-0.12, 0.5, name, transform=row[0].transAxes, rotation=90, va="center", ha="right")
    save(figure, "functions")
