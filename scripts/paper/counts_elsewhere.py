"""Counts for regions of any shape, and in the plane limit: parts of docs/shannon.md."""

from __future__ import annotations

import math

import numpy as np
from paper.tables import prose, table

import slepian_prt as sp
from slepian_prt.sphere.regions import Region


def _chart(corners: list[tuple[float, float]], size: float) -> Region:
    """A polygon about the z axis whose corners are given in the tangent plane there."""
    return sp.polygon_region([(size * x, size * y, 1.0) for x, y in corners])


def _regions() -> list[tuple[str, Region]]:
    pole, aside = (0.0, 0.0, 1.0), (math.sin(0.4), 0.0, math.cos(0.4))
    mask = np.zeros((18, 36), dtype=bool)
    mask[5:9, :9] = True
    mask[7:12, 12:16] = True
    bend = [(-1.0, -1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (-1.0, 1.0)]
    return [
        ("cap of 30°", sp.cap_region(pole, math.radians(30))),
        ("two caps of 17°, apart", sp.cap_region(pole, 0.3) | sp.cap_region((1.0, 0.0, 0.0), 0.3)),
        ("ring, 23° to 40°", sp.cap_region(pole, 0.7) - sp.cap_region(pole, 0.4)),
        ("crescent of two caps of 34°", sp.cap_region(pole, 0.6) - sp.cap_region(aside, 0.6)),
        ("octant", sp.polygon_region(np.eye(3))),
        ("square of 44°", _chart([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)], 0.4)),
        ("L of three squares of 27°", _chart(bend, 0.5)),
        ("mask of two rectangles", sp.mask_region(mask)),
    ]


def region_lines() -> list[str]:
    """N, N_g and N_ref of regions from their area and the length of their boundary."""
    rows, errors, widths = [], [], []
    for bandlimit in (10, 20):
        for name, region in _regions():
            widths.append((bandlimit + 1) * _width(region))
            values = sp.region_basis(bandlimit, region).eigenvalues
            for epsilon in (0.1, 0.01, 0.001):
                count = int((values > epsilon).sum())
                numbers = (
                    sp.shannon_number(bandlimit, region),
                    sp.generalized_shannon_number(bandlimit, region, epsilon),
                    sp.refined_shannon_number(bandlimit, region, epsilon),
                )
                errors.append([abs(x / count - 1.0) for x in numbers])
                rows.append([str(bandlimit), name, f"{epsilon:g}", str(count), *(f"{x:.1f}" for x in numbers)])
    mean = np.mean(errors, axis=0)
    return [
        "## Regions of any shape",
        "",
        *prose(
            f"""`sp.shannon_number` and its kin take a region in place of a half-angle, and use its area
            (`sp.region_area`) and the length of its boundary (`sp.region_boundary`). N_ref has |∂U|/2π for the
            sin Θ before its brackets and 2A(1 - A/4π)/|∂U| for that in the logarithm; both are sin Θ where the
            region is a cap. Mean of \\|estimate/count - 1\\| over these {len(errors)} cases: N {mean[0]:.2f},
            N_g {mean[1]:.2f}, N_ref {mean[2]:.2f}."""
        ),
        *table(("L", "region", "ε", "count", "N", "N_g", "N_ref"), rows),
        *prose(
            f"""These regions are fat: L+1 times that width in the logarithm is {min(widths):.1f} or more. N_ref is for
            such. On thinner ones its second term soon stops growing with 1/ε, and stays as it is; below about
            .09 there is none, for a cap as for any region. So it is never below N for ε < ½,
            but far too low. N_g, which knows no width,
            may be the better estimate; the count is exact. Rings at L = 10, ε = 0.01, from the outer angle of 57°
            inwards:"""
        ),
        *table(("width", "L+1 times the width", "count", "N", "N_g", "N_ref"), _thin_rows()),
    ]


def _width(region: Region) -> float:
    """2A(1 - A/4π)/|∂U|, sin Θ of a cap and the width of a thin ring."""
    area = sp.region_area(region)
    return 2.0 * area * (1.0 - area / (4.0 * math.pi)) / sp.region_boundary(region)


def _thin_rows() -> list[list[str]]:
    """Numbers of rings that become thin."""
    rows, pole = [], (0.0, 0.0, 1.0)
    for width in (0.3, 0.1, 0.03, 0.01):
        ring = sp.cap_region(pole, 1.0) - sp.cap_region(pole, 1.0 - width)
        numbers = (
            sp.shannon_number(10, ring),
            sp.generalized_shannon_number(10, ring, 0.01),
            sp.refined_shannon_number(10, ring, 0.01),
        )
        count = sp.concentration_count(10, ring, 0.01)
        angle = f"{math.degrees(width):.2g}°"
        rows.append([angle, f"{11.0 * _width(ring):.2f}", str(count), *(f"{x:.1f}" for x in numbers)])
    return rows


def plane_lines() -> list[str]:
    """Concentrations of ever smaller caps with the same (L+1)Θ, against those of a disc of the plane."""
    products, bandlimits = (2.0, 6.0), (10, 20, 40, 80, 160)
    rows = []
    for product in products:
        disc = sp.disc_concentrations(product).eigenvalues
        rows.append([f"{product:g}"])
        for bandlimit in bandlimits:
            half_angle = product / (bandlimit + 1)
            cap = sp.cap_basis(bandlimit, half_angle).eigenvalues
            shown = min(cap.size, disc.size)
            difference = float(np.abs(cap[:shown] - disc[:shown]).max())
            rows[-1].append(f"{difference:.1e} (Θ = {math.degrees(half_angle):.2g}°)")
    return [
        "## The plane limit",
        "",
        *prose(
            """On a small cap the sphere's problem becomes that of a disc of the plane (Slepian 1964; Simons,
            Dahlen and Wieczorek 2006), of which only c = (L+1)Θ counts. `sp.disc_concentrations(c)` solves that
            one by finite Hankel transforms, order by order. The largest difference of any concentration falls
            to a quarter as L doubles. A small region of the sphere of any other shape is one of the plane, with
            (L+1) times its size for the product of bandlimit and size:"""
        ),
        *table(("c", *(f"L = {l}" for l in bandlimits)), rows),
    ]


def line_lines() -> list[str]:
    """The paper's Eq. 5 on the line, with the reading of its symbols that makes it true."""
    rows = []
    for product in (5.0, 20.0, 100.0):
        values = sp.line_concentrations(product)
        for epsilon in (0.5, 0.1, 0.01, 0.001):
            readings = (sp.line_number(x, epsilon) for x in (product, product / 2.0, 2.0 * product))
            count = int((values > epsilon).sum())
            rows.append([f"{product:g}", f"{epsilon:g}", str(count), *(f"{x:.1f}" for x in readings)])
    return [
        "## The line",
        "",
        *prose(
            """The paper's Eq. 5, C̃/π + log((1-ε)/ε) log(C̃)/π² with C̃ = L̃Ũ, is about functions on the line. It
            holds with natural logarithms, one side of the band and the whole interval: for frequencies |ω| ≤ L
            and places |x| ≤ R it has L̃ = L, Ũ = 2R and C̃ = 2c with c = LR (`sp.line_number`).
            `sp.line_concentrations(c)` has the exact concentrations, those of prolate spheroidal wave
            functions."""
        ),
        *table(("c", "ε", "count", "C̃ = 2c", "C̃ = c", "C̃ = 4c"), rows),
    ]
