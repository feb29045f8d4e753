"""Estimates of how many functions matter against exact counts: docs/shannon.md."""

from __future__ import annotations

import math

import numpy as np
from drawing import ROOT

import slepian_prt as sp


def shannon() -> None:
    """docs/shannon.md: every estimate of the number of functions against the exact count."""
    grid = [(l, t) for l in (2, 5, 10, 20, 50, 100) for t in (5, 10, 20, 30, 60, 90)]
    rows, errors = [], []
    for bandlimit, angle in grid:
        half_angle = math.radians(angle)
        concentrations = sp.cap_basis(bandlimit, half_angle).eigenvalues
        for epsilon in (0.5, 0.1, 0.01, 0.001):
            count = int((concentrations > epsilon).sum())
            estimates = [
                sp.shannon_number(bandlimit, half_angle),
                sp.generalized_shannon_number(bandlimit, half_angle, epsilon, log_base=math.e),
                sp.generalized_shannon_number(bandlimit, half_angle, epsilon),
                sp.refined_shannon_number(bandlimit, half_angle, epsilon),
            ]
            numbers = " | ".join(f"{x:.1f}" for x in estimates)
            rows.append(f"| {bandlimit} | {angle}° | {epsilon:g} | {count} | {numbers} |")
            if count:
                errors.append([estimates[0], *(abs(x / count - 1) for x in estimates)])
    table = np.array(errors)
    names = ("N", "N_g, natural logarithms", "N_g, base-10 logarithms (the paper, as we read it)", "N_ref")
    lines = [
        "# Shannon numbers against exact counts",
        "",
        "Made by `scripts/figures shannon`. The count is that of concentrations above ε of a cap of half-angle Θ at",
        "bandlimit L. Mean relative error over the grid below (cases with a count above zero):",
        "",
        "| estimate | all | N ≥ 3 | N ≥ 10 |",
        "| --- | --- | --- | --- |",
    ]
    for column, name in enumerate(names, start=1):
        means = (table[table[:, 0] >= least, column].mean() for least in (0, 3, 10))
        lines.append(f"| {name} | " + " | ".join(f"{mean:.3f}" for mean in means) + " |")
    lines += [
        "",
        "Radially symmetric functions alone (order 0), C = 4(L+1)Θ, at ε = 0.5:",
        "",
        "| L | Θ | count | C/4π |",
        "| --- | --- | --- | --- |",
    ]
    for bandlimit, angle in ((10, 30), (20, 60), (50, 20), (100, 60)):
        count = sp.concentration_count(bandlimit, math.radians(angle), 0.5, radially_symmetric=True)
        number = sp.generalized_shannon_number(bandlimit, math.radians(angle), 0.5, radially_symmetric=True)
        lines.append(f"| {bandlimit} | {angle}° | {count} | {number:.2f} |")
    lines += ["", "| L | Θ | ε | count | N | N_g natural | N_g base 10 | N_ref |", "| --- " * 8 + "|", *rows, ""]
    (ROOT / "docs" / "shannon.md").write_text("\n".join(lines))
    print("docs/shannon.md")
