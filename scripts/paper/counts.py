"""Estimates of how many functions matter against exact counts: docs/shannon.md."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from drawing import ROOT
from numpy.typing import NDArray
from paper.counts_elsewhere import line_lines, plane_lines, region_lines
from paper.tables import listed, prose, table

import slepian_prt as sp
from slepian_prt.slepian.shannon import count_above

BANDLIMITS = (2, 5, 10, 20, 50, 100)
DEGREES = (5, 10, 20, 30, 60, 90)
EPSILONS = (0.5, 0.1, 0.01, 0.001)

KERNELS = (("diffuse", 1.0), ("Phong 16", 16.0), ("Phong 128", 128.0))


def shannon() -> None:
    """docs/shannon.md: every estimate of the number of functions against the exact count."""
    caps = np.array(list(_cap_cases()))
    lines = [
        "# Shannon numbers against exact counts",
        "",
        *prose(
            """Made by `scripts/figures shannon`. N is the Shannon number, N_g the paper's generalised one (Eq. 6),
            N_ref our two-term asymptotics ([theory](theory.md#how-many-functions)). They are real numbers and
            counts are whole, so the best of estimates is a quarter of a function off on the average."""
        ),
        *_mean_lines(caps),
        *_transport_lines(),
        *_radial_lines(),
        *region_lines(),
        *plane_lines(),
        *line_lines(),
        "## All cases of caps",
        "",
        *table(("L", "Θ", "ε", "count", "N", "N_g natural", "N_g base 10", "N_ref"), map(_cells, caps)),
    ]
    (ROOT / "docs" / "shannon.md").write_text("\n".join(lines).rstrip() + "\n")
    print("docs/shannon.md")


def _cap_cases() -> Iterator[tuple[float, ...]]:
    """L, Θ in degrees, ε, the exact count, and the four estimates."""
    for bandlimit in BANDLIMITS:
        for angle in DEGREES:
            half_angle = math.radians(angle)
            concentrations = sp.cap_basis(bandlimit, half_angle).eigenvalues
            for epsilon in EPSILONS:
                yield (
                    bandlimit,
                    angle,
                    epsilon,
                    count_above(concentrations, epsilon),
                    sp.shannon_number(bandlimit, half_angle),
                    sp.generalized_shannon_number(bandlimit, half_angle, epsilon, log_base=math.e),
                    sp.generalized_shannon_number(bandlimit, half_angle, epsilon),
                    sp.refined_shannon_number(bandlimit, half_angle, epsilon),
                )


def _cells(case: NDArray) -> list[str]:
    """A row of a table: L, Θ, ε, the count, and estimates."""
    bandlimit, angle, epsilon, count, *estimates = case
    return [f"{bandlimit:.0f}", f"{angle:.0f}°", f"{epsilon:g}", f"{count:.0f}", *(f"{x:.1f}" for x in estimates)]


# --- Caps, all functions ---------------------------------------------------------------------------------------------


def _mean_lines(caps: NDArray) -> list[str]:
    count, numbers = caps[:, 3], caps[:, 4:]
    some = count > 0
    relative = np.abs(numbers[some] / count[some, None] - 1.0)
    names = ("N", "N_g, natural logarithms", "N_g, base-10 logarithms (the paper, as we read it)", "N_ref")
    rows = [
        [name, *(f"{errors[numbers[some, 0] >= least].mean():.3f}" for least in (0, 3, 10))]
        for name, errors in zip(names, relative.T, strict=True)
    ]
    bare = np.array([_bare_numbers(*case[:3]) for case in caps])
    others = np.mean(np.abs(bare - count[:, None]) / np.maximum(count, 1.0)[:, None], axis=0)
    made_again = ", ".join(f"{x:.3f}" for x in others)
    return [
        "## Caps",
        "",
        *prose(
            f"""The count is that of concentrations above ε of a cap of half-angle Θ at bandlimit L: {count.size}
            cases of L in {listed(BANDLIMITS)}, Θ in {listed(DEGREES)}° and ε in {listed(EPSILONS)}, which stand
            at the end of the page. Mean of \\|estimate/count - 1\\| over the cases with a count above zero, of
            the numbers as the functions return them: the second term of N_g dropped where the region is too
            small for it, all clipped to [0, (L+1)²]."""
        ),
        *table(("estimate", f"all {some.sum()}", "N ≥ 3", "N ≥ 10"), rows),
        *prose(
            f"""The design of this package quotes .38, 2.14, .25 and .17 for all cases. They belong to another set:
            all {count.size} cases, a count of zero taken for one, and the bare formulas, nothing dropped or
            clipped. Made again so they are {made_again}. The plain problem has N functions by Szegő's theorem
            (Mahajan et al. 2007), so that the row of N is that estimate's too."""
        ),
    ]


def _bare_numbers(bandlimit: float, angle: float, epsilon: float) -> tuple[float, float, float, float]:
    """The four estimates without dropping or clipping anything."""
    from scipy.special import loggamma

    k, half_angle, ratio = bandlimit + 1, math.radians(angle), math.log((1 - epsilon) / epsilon)
    sine, cosine = math.sin(half_angle), math.cos(half_angle)
    number = k * k * math.sin(half_angle / 2) ** 2
    boundary = 2 * math.log(k * 2 * math.pi * sine) / math.log(2 * math.pi)
    second = ratio * boundary * math.log(4 * math.pi * number)
    curvature = 1 - math.log(2) if angle == 90 else 1 - math.log(cosine) - math.atanh(sine) / sine
    phase = 2 * math.pi * float(loggamma(complex(0.5, ratio / (2 * math.pi))).imag)
    refined = k * sine / math.pi**2 * (ratio * math.log(32 * math.exp(curvature - 3) * k * sine) - phase)
    return number, number + second, number + second / math.log(10) ** 2, number + refined


# --- Transport -------------------------------------------------------------------------------------------------------


def _transport_lines() -> list[str]:
    """Counts of transport's own problem, and the estimates that know the kernel beside those that do not."""
    names = ("N", "N_g", "N_ref", "Szegő", "N_ref of the band")
    means, shown = [], []
    for name, exponent in KERNELS:
        cases = np.array(list(_transport_cases(exponent)))
        for least in (1, 10):
            some = cases[cases[:, 3] >= least]
            errors = np.mean(np.abs(some[:, 4:] / some[:, 3:4] - 1.0), axis=0)
            means.append([name, f"≥ {least}: {len(some)} cases", *(f"{x:.2f}" for x in errors)])
        for case in cases:
            if case[0] == 20 and case[1] in (10, 30, 90) and case[2] in (0.1, 0.01):
                shown.append([name, *_cells(case)])
    return [
        "## Transport",
        "",
        *prose(
            """Diffuse and glossy transport spread their energy unevenly over the degrees, and their own problem
            over a cap (`spectrum --kernel`, the dashed curves of [Fig. 3](theory.md#the-papers-figures)) has
            fewer eigenvalues above ε of the first than the plain problem has concentrations. N, N_g and N_ref
            know only L."""
        ),
        *prose(
            """Mahajan, Shlizerman, Ramamoorthi and Belhumeur (*A Theory of Locally Low Dimensional Light
            Transport*, SIGGRAPH 2007) find the eigenvalues of the covariance of transport over a patch by
            Szegő's theorem: they are spread as the kernel's power spectrum is, and those that matter grow with
            the area of the patch. That much is taken from their abstract and from what Lessig and Fiume say of
            it; they work in flatland, and the form on the sphere is ours: (A/4π) Σ (2l+1) over the degrees with
            t_l² > ε max t² (`sp.szego_number`). There is no second term. The last column is N_ref with the
            highest of these degrees for L, which adds one (`sp.refined_shannon_number(…, kernel=…)`)."""
        ),
        *prose(f"""Mean of \\|estimate/count - 1\\| over L in {listed(BANDLIMITS[:-1])} and Θ and ε as above:"""),
        *table(("kernel", "count", *names), means),
        *prose(
            """Szegő's theorem knows what counts, and is too low for want of a boundary. The second term that
            Lessig and Fiume added helps, at the bandlimit that a kernel really has; it is too large where the
            power falls slowly through ε. At L = 20:"""
        ),
        *table(("kernel", "L", "Θ", "ε", "count", *names), shown),
    ]


def _transport_cases(exponent: float) -> Iterator[tuple[float, ...]]:
    for bandlimit in BANDLIMITS[:-1]:
        kernel = sp.cosine_lobe(bandlimit, exponent)
        for angle in DEGREES:
            cap = bandlimit, math.radians(angle)
            values = sp.cap_basis(*cap, kernel=kernel).eigenvalues
            for epsilon in EPSILONS:
                yield (
                    bandlimit,
                    angle,
                    epsilon,
                    count_above(values, epsilon * values[0]),
                    sp.shannon_number(*cap),
                    sp.generalized_shannon_number(*cap, epsilon),
                    sp.refined_shannon_number(*cap, epsilon),
                    sp.szego_number(*cap, epsilon, kernel=kernel),
                    sp.refined_shannon_number(*cap, epsilon, kernel=kernel),
                )


# --- Radial symmetry -------------------------------------------------------------------------------------------------


def _radial_lines() -> list[str]:
    """Functions of order 0 alone, the paper's Eq. 9, where its N_g is far too large."""
    cases = np.array(list(_radial_cases()))
    some = cases[cases[:, 3] > 0]
    relative = np.mean(np.abs(some[:, 4:] / some[:, 3:4] - 1.0), axis=0)
    absolute = np.mean(np.abs(cases[:, 4:] - cases[:, 3:4]), axis=0)
    rounded = np.mean(np.rint(cases[:, 4:]) == cases[:, 3:4], axis=0)
    fine = some[some[:, 2] == 0.01]
    ratios = fine[:, 5] / fine[:, 3]
    low, high = (
        f"{ratios[i]:.2g} (L = {fine[i, 0]:.0f}, {fine[i, 1]:.0f}°)" for i in (ratios.argmin(), ratios.argmax())
    )
    names = ("N = (L+1)Θ/π", "N_g", "whole term", "N_ref")
    means = [
        [name, f"{a:.3f}", f"{b:.2f}", f"{c:.0%}"]
        for name, a, b, c in zip(names, relative, absolute, rounded, strict=True)
    ]
    shown = ((5, 10), (10, 10), (10, 20), (10, 30), (20, 60), (50, 20), (100, 60))
    return [
        "## Radially symmetric functions",
        "",
        *prose(
            f"""Under light that is symmetric about the axis of a cap only functions of order 0 count, L+1 of them
            (the paper's Eq. 9). There **the paper's N_g, with C = 4(L+1)Θ, is mostly far too large**: at ε = .5,
            where its second term vanishes, it is the right number, at ε = .01 it is {np.median(ratios):.1f} times
            the count in the median of our {len(fine)} caps, as 9.4 for 2 at L = 10, Θ = 20°. The ratio is from
            {low} to {high}: below 1 on the {np.sum(ratios < 1.0)} smallest caps alone, where the logarithms of the
            second term are near 0, and below 2 on the largest, where more functions count and N_g is often clipped
            to L+1. What fits is N_ref of order 0 (`radially_symmetric=True`, [`spectrum
            --radial`](guide/spectrum.md)),"""
        ),
        "    KΘ/π + (1/2π²) [ℓ ln(4K sin Θ) - 2π Im lnΓ(½ + iℓ/2π)] + 3 (ℓ²/π² - 1)/(16π K tan Θ)",
        "",
        *prose(
            f"""with K = L+1, ℓ = ln((1-ε)/ε), the sum no further from ℓ = 0 than it grows, and half of the logarithmic
            term of the line, whose interval has two ends where [0, Θ] has one. The whole term, KΘ/π + ℓ ln(4K
            sin Θ)/π², is too large by the other half. By Szegő's theorem the number is KΘ/π. Mean errors over the
            same {len(cases)} cases as above:"""
        ),
        *table(
            ("estimate", f"relative, {len(some)} with a count", "in functions, all", "rounded, it is the count"), means
        ),
        *table(("L", "Θ", "ε", "count", *names), [_cells(case) for case in cases if (case[0], case[1]) in shown]),
    ]


def _radial_cases() -> Iterator[tuple[float, ...]]:
    for bandlimit in BANDLIMITS:
        for angle in DEGREES:
            half_angle = math.radians(angle)
            values = sp.cap_basis(bandlimit, half_angle, radially_symmetric=True).eigenvalues
            for epsilon in EPSILONS:
                number = sp.shannon_number(bandlimit, half_angle, radially_symmetric=True)
                logarithm = math.log((1.0 - epsilon) / epsilon) * math.log(4.0 * (bandlimit + 1) * math.sin(half_angle))
                yield (
                    bandlimit,
                    angle,
                    epsilon,
                    int((values > epsilon).sum()),
                    number,
                    sp.generalized_shannon_number(bandlimit, half_angle, epsilon, radially_symmetric=True),
                    number + logarithm / math.pi**2,
                    sp.refined_shannon_number(bandlimit, half_angle, epsilon, radially_symmetric=True),
                )
