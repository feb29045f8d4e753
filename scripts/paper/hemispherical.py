"""Bases over the hemisphere against Slepian functions: what Lessig & Fiume (Sec. 4) say of them, measured."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from drawing import COLORS, save
from numpy.typing import NDArray
from paper.closure import (
    gram_in_cap,
    hemispherical_gram_in_cap,
    lost_by_hemispherical,
    lost_by_rotation,
    off_diagonal,
)
from paper.models import Model, models

import slepian_prt as sp
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.methods import METHODS, Workload
from slepian_prt.evaluation.metrics import relative_rms
from slepian_prt.sphere.hemispherical import h_basis_in_sh, sh_over_hemisphere

HALF = 0.5 * math.pi
CAP = math.radians(30.0)
BANDLIMIT = 10
TERMS = (4, 9, 16, 25, 36)
ANGLES = (10, 30, 90)


class _Space(NamedTuple):
    """Functions in spherical harmonics, (K, (L+1)²), and the half-angle of the region that they are made for."""

    name: str
    functions: NDArray[np.float64]
    region: float


def _spaces() -> list[_Space]:
    hemisphere, cap = sp.cap_basis(BANDLIMIT, HALF).functions.T, sp.cap_basis(BANDLIMIT, CAP).functions.T
    every = f"all {len(cap)} of L = {BANDLIMIT}"
    return [
        _Space("SH, 16 (degrees < 4)", np.eye(16), math.pi),
        _Space(f"Slepian of the hemisphere, {every}", hemisphere, HALF),
        _Space(f"Slepian of the hemisphere, first 16 of L = {BANDLIMIT}", hemisphere[:16], HALF),
        _Space(f"Slepian of a cap of 30°, {every}", cap, CAP),
        _Space(f"Slepian of a cap of 30°, first 16 of L = {BANDLIMIT}", cap[:16], CAP),
        _Space("H-basis, 4", h_basis_in_sh(4)[:, :4], HALF),
        _Space("H-basis, 6", h_basis_in_sh(6), HALF),
        _Space("H-basis, 9", h_basis_in_sh(9), HALF),
    ]


def hemispherical() -> None:
    """HSH and the H-basis beside SH and Slepian functions: orthogonality, rotation, and errors at equal K."""
    _print_orthogonality()
    _print_rotation()
    figure, (errors, rotation) = plt.subplots(2, 1, figsize=(7.2, 9.6), gridspec_kw={"hspace": 0.62})
    _draw_rotation(rotation)
    print("| model | functions | " + " | ".join(f"`{name}`" for name in METHODS_COMPARED) + " |")
    print("| --- | --- " + "| --- " * len(METHODS_COMPARED) + "|")
    measured_on = list(models("skull"))
    for model, dash in zip(measured_on, ("-", "--"), strict=False):
        measured = {name: list(_errors(model, name)) for name in METHODS_COMPARED}
        for i, terms in enumerate(TERMS):
            cells = " | ".join(f"{100 * rows[i][0]:.1f}, {100 * rows[i][1]:.1f}" for rows in measured.values())
            print(f"| {model.name} | {terms} | {cells} |")
        for (name, rows), color in zip(measured.items(), COLORS, strict=True):
            marker = METHODS[name].style.marker
            errors.plot(
                TERMS,
                [100 * row[0] for row in rows],
                dash,
                marker=marker,
                color=color,
                label=f"{name}, {model.name.split(',')[0]}",
            )
    errors.set(xlabel="functions per vertex, K", ylabel="error of the transfer vectors, %", yscale="log")
    errors.set_yticks((5, 10, 20, 50), ("5", "10", "20", "50"))
    errors.minorticks_off()
    errors.set_xticks(TERMS)
    errors.grid(True, color="#dddddd", linewidth=0.6)
    errors.legend(frameon=False, fontsize=10, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    if len(measured_on) == 1:  # the shipped figure has the skull too: it stays
        print("SLEPIAN_PRT_DATA names no folder with meshes/skull.ply: the knot alone, under a name of its own")
    save(figure, "hemispherical" if len(measured_on) > 1 else "hemispherical_knot")


METHODS_COMPARED = ("slepian", "adapted", "hsh", "sh")


def _print_orthogonality() -> None:
    print("| functions | over what they are made for | over the sphere | over a cap of 30° | energy in degrees ≤ 10 |")
    print("| --- | --- | --- | --- | --- |")
    for name, functions, region in _spaces():
        grams = [gram_in_cap(functions, region), functions @ functions.T, gram_in_cap(functions, CAP)]
        print(f"| {name} | " + " | ".join(_small(off_diagonal(gram)) for gram in grams) + " | 1 |")
    grams = [hemispherical_gram_in_cap(3, angle) for angle in (HALF, CAP)]
    held = float(np.sum(sh_over_hemisphere(BANDLIMIT, 3) ** 2)) / 16
    own, cap = (_small(off_diagonal(gram)) for gram in grams)
    print(f"| HSH, 16 (zero below) | {own} | {own} | {cap} | {held:.3f} |")


def _print_rotation() -> None:
    print("| functions, turned about a horizontal axis by | " + " | ".join(f"{angle}°" for angle in ANGLES) + " |")
    print("| --- " * (len(ANGLES) + 1) + "|")
    turned = [math.radians(angle) for angle in ANGLES]
    for name, functions, _ in _spaces():
        print(f"| {name} | " + " | ".join(_small(lost_by_rotation(functions, angle)) for angle in turned) + " |")
    lost = [lost_by_hemispherical(3, angle) for angle in turned]
    for name, which in (("HSH, 16", 0), ("HSH, 16, of what stays above the horizon", 1)):
        print(f"| {name} | " + " | ".join(_small(row[which]) for row in lost) + " |")


def _draw_rotation(axis: plt.Axes) -> None:
    """Energy lost against the angle of rotation."""
    degrees = np.arange(0, 91, 5)
    angles = np.radians(degrees)
    spaces = {space.name: space.functions for space in _spaces()}
    first = f"first 16 of L = {BANDLIMIT}"
    curves = (
        ("SH; all Slepian functions of L; H-basis, 4 and 9", spaces["SH, 16 (degrees < 4)"], COLORS[3], "-"),
        (f"Slepian of a cap of 30°, {first}", spaces[f"Slepian of a cap of 30°, {first}"], COLORS[0], "-"),
        (f"Slepian of the hemisphere, {first}", spaces[f"Slepian of the hemisphere, {first}"], COLORS[0], "--"),
        ("H-basis, 6", spaces["H-basis, 6"], COLORS[1], "-"),
    )
    for name, functions, color, dash in curves:
        lost = [100 * lost_by_rotation(functions, angle) for angle in angles]
        axis.plot(degrees, lost, dash, color=color, label=name)
    lost = np.array([lost_by_hemispherical(3, angle) for angle in angles])
    axis.plot(degrees, 100 * lost[:, 0], "-", color=COLORS[2], label="HSH, 16")
    axis.plot(degrees, 100 * lost[:, 1], "--", color=COLORS[2], label="HSH, 16, of what stays above the horizon")
    axis.set(xlabel="turned by, degrees", ylabel="energy that is lost, %", ylim=(-2, 102), xticks=range(0, 91, 15))
    axis.grid(True, color="#dddddd", linewidth=0.6)
    axis.legend(frameon=False, fontsize=10, ncols=1, loc="upper center", bbox_to_anchor=(0.5, -0.15))


def _errors(model: Model, method: str) -> Iterator[tuple[float, float]]:
    """Errors of transfer and of relit radiance with each number of functions."""
    transfer, lighting = _traced(model)
    exact = sp.relight(transfer, lighting)
    groups = group_transfer(CompressionSettings(), transfer)
    work = Workload(transfer, groups, [lighting], TERMS, lambda _: None, ())
    for run in METHODS[method].run(work):
        yield (
            relative_rms(run.transfer.reconstruct(), transfer.vectors),
            relative_rms(run.radiance(lighting), exact),
        )


@cache
def _traced(model: Model) -> tuple[sp.Transfer, NDArray[np.float64]]:
    """Transfer and light of a model."""
    return sp.precompute(model.mesh, BANDLIMIT, 1024), model.lighting(BANDLIMIT)


def _small(value: float) -> str:
    """A part for readers: rounding is none."""
    return "0" if abs(value) < 1e-12 else f"{value:.3f}" if value >= 5e-4 else f"{value:.0e}"
