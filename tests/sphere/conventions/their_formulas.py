"""What other tools make of their coefficients, written here from their sources, for one direction after the other.

Each takes coefficients in the tool's own arrays, and directions (n, 3), and gives values (n, 3) of red, green, blue.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import assoc_legendre_p


def d3dx(coefficients, d):
    """D3DXSHEvalDirection (as in Wine's d3dx9_36/math.c), and D3DXSHDot, a call for each colour; orders 2 to 4."""
    x, y, z = d.T
    pi, order = math.pi, math.isqrt(coefficients.shape[-1])
    out = [
        0.5 / math.sqrt(pi) + 0.0 * x,
        -0.5 / math.sqrt(pi / 3) * y,
        0.5 / math.sqrt(pi / 3) * z,
        -0.5 / math.sqrt(pi / 3) * x,
        0.5 / math.sqrt(pi / 15) * x * y,
        -0.5 / math.sqrt(pi / 15) * y * z,
        0.25 / math.sqrt(pi / 5) * (3 * z * z - 1),
        -0.5 / math.sqrt(pi / 15) * x * z,
        0.25 / math.sqrt(pi / 15) * (x * x - y * y),
        -math.sqrt(70 / pi) / 8 * y * (3 * x * x - y * y),
        math.sqrt(105 / pi) / 2 * x * y * z,
        -math.sqrt(42 / pi) / 8 * y * (-1 + 5 * z * z),
        math.sqrt(7 / pi) / 4 * z * (5 * z * z - 3),
        -math.sqrt(42 / pi) / 8 * x * (-1 + 5 * z * z),
        math.sqrt(105 / pi) / 4 * z * (x * x - y * y),
        -math.sqrt(70 / pi) / 8 * x * (x * x - 3 * y * y),
    ]
    return np.stack([sum(c * o for c, o in zip(one, out[: order**2], strict=True)) for one in coefficients], axis=1)


def pifu_harmonics(bandlimit, theta, phi):
    """``getSHCoeffs`` of prt_util.py: (n, M), harmonics that go with the angles of its samples."""
    rows = []
    for degree in range(bandlimit + 1):
        for m in range(-degree, degree + 1):
            ratio = math.factorial(degree - abs(m)) / math.factorial(degree + abs(m))
            k = math.sqrt((2 * degree + 1) / (4 * math.pi) * ratio)
            p = assoc_legendre_p(degree, abs(m), np.cos(theta))[0]  # with the Condon–Shortley phase, as theirs
            turn = np.cos(m * phi) if m >= 0 else np.sin(-m * phi)
            rows.append((math.sqrt(2.0) if m else 1.0) * k * turn * p)
    return np.stack(rows, axis=1)


def pifu_angles(d):
    """Angles (theta, phi) whose sample is d = (-sin θ cos φ, -sin θ sin φ, cos θ), as ``sampleSphericalDirections``."""
    return np.arccos(np.clip(d[:, 2], -1.0, 1.0)), np.arctan2(-d[:, 1], -d[:, 0])


def pifu(coefficients, d):
    """Light of ``env_sh.npy``, (M, 3), from a direction."""
    return pifu_harmonics(math.isqrt(len(coefficients)) - 1, *pifu_angles(d)) @ coefficients


def three(coefficients, d):
    """``SphericalHarmonics3.getAt``."""
    x, y, z = d.T[:, :, None]
    c = coefficients
    result = c[0] * 0.28209479177387814 + 0.0 * x
    result = result + c[1] * 0.4886025119029199 * y + c[2] * 0.4886025119029199 * z + c[3] * 0.4886025119029199 * x
    result = result + c[4] * 1.0925484305920792 * (x * y) + c[5] * 1.0925484305920792 * (y * z)
    result = result + c[6] * 0.31539156525252005 * (3.0 * z * z - 1.0) + c[7] * 1.0925484305920792 * (x * z)
    return result + c[8] * 0.5462742152960396 * (x * x - y * y)


def filament(coefficients, d):
    """``CubemapSH::renderSH``: its basis with ``Pmm = (1 − 2m) Pmm``, times ``Kml`` and √2 for m > 0."""
    x, y, z = d.T
    bands = math.isqrt(len(coefficients))
    basis = np.zeros((bands * bands, len(d)))
    cosine, sine = np.ones(len(d)), np.zeros(len(d))
    pmm = 1.0
    for m in range(bands):
        if m:
            pmm *= 1.0 - 2 * m
            cosine, sine = cosine * x - sine * y, sine * x + cosine * y
        older, old = 0.0 * z, pmm + 0.0 * z
        for l in range(m, bands):
            if l > m:
                older, old = old, ((2 * l - 1) * old * z - (l + m - 1) * older) / (l - m)
            k = math.sqrt((2 * l + 1) * math.factorial(l - m) / math.factorial(l + m)) / math.sqrt(4 * math.pi)
            k *= math.sqrt(2.0) if m else 1.0
            basis[l * l + l + m] = k * old * cosine
            if m:
                basis[l * l + l - m] = k * old * sine
    return basis.T @ coefficients


def filament_irradiance(coefficients, n):
    """The same of ``computeSH(…, irradiance=true)``, whose ``truncatedCosSh`` are π, 2π/3, π/4: over π, as it draws."""
    return filament(coefficients, n) / math.pi


def filament_shader(coefficients, n):
    """``renderPreScaledSH3Bands``: irradiance over π at a normal."""
    x, y, z = n.T
    one = np.ones(len(n))
    return np.stack([one, y, z, x, y * x, y * z, 3 * z * z - 1, z * x, x * x - y * y], axis=1) @ coefficients


def google(coefficients, d):
    """``EvalSH`` with the functions up to degree 4 that it has written out; six digits, as theirs."""
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        0.282095 + 0.0 * x,
        -0.488603 * y, 0.488603 * z, -0.488603 * x,
        1.092548 * x * y, -1.092548 * y * z, 0.315392 * (-xx - yy + 2.0 * zz), -1.092548 * x * z,
        0.546274 * (xx - yy),
        -0.590044 * y * (3.0 * xx - yy), 2.890611 * x * y * z, -0.457046 * y * (4.0 * zz - xx - yy),
        0.373176 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.457046 * x * (4.0 * zz - xx - yy),
        1.445306 * z * (xx - yy), -0.590044 * x * (xx - 3.0 * yy),
        2.503343 * x * y * (xx - yy), -1.770131 * y * z * (3.0 * xx - yy), 0.946175 * x * y * (7.0 * zz - 1.0),
        -0.669047 * y * z * (7.0 * zz - 3.0), 0.105786 * (35.0 * zz * zz - 30.0 * zz + 3.0),
        -0.669047 * x * z * (7.0 * zz - 3.0), 0.473087 * (xx - yy) * (7.0 * zz - 1.0),
        -1.770131 * x * z * (xx - 3.0 * yy), 0.625836 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)),
    ]  # fmt: skip
    return np.stack(basis[: coefficients.shape[-1]], axis=1) @ coefficients.T


def deca(coefficients, n):
    """``add_SHlight`` of decalib/utils/renderer.py: shading at a normal, times the albedo."""
    pi, sqrt = math.pi, math.sqrt
    factor = np.array([
        1 / sqrt(4 * pi), ((2 * pi) / 3) * (sqrt(3 / (4 * pi))), ((2 * pi) / 3) * (sqrt(3 / (4 * pi))),
        ((2 * pi) / 3) * (sqrt(3 / (4 * pi))), (pi / 4) * 3 * (sqrt(5 / (12 * pi))),
        (pi / 4) * 3 * (sqrt(5 / (12 * pi))), (pi / 4) * 3 * (sqrt(5 / (12 * pi))),
        (pi / 4) * (3 / 2) * (sqrt(5 / (12 * pi))), (pi / 4) * (1 / 2) * (sqrt(5 / (4 * pi))),
    ])  # fmt: skip
    x, y, z = n.T
    sh = np.stack([0 * x + 1.0, x, y, z, x * y, x * z, y * z, x**2 - y**2, 3 * z**2 - 1], axis=1) * factor
    return sh @ coefficients


def shtools(coefficients, d):
    """Real, 4π-normalised, without the phase: Σ (C_lm cos mφ + S_lm sin mφ) P̄_lm (Wieczorek & Meschede 2018, Eq. 1)."""
    phi = np.arctan2(d[:, 1], d[:, 0])
    values = np.zeros((len(d), 3))
    for l in range(coefficients.shape[-1]):
        for m in range(l + 1):
            ratio = math.factorial(l - m) / math.factorial(l + m)
            p = (-1) ** m * assoc_legendre_p(l, m, d[:, 2])[0]  # scipy's has the phase
            p = p * math.sqrt((1.0 if m == 0 else 2.0) * (2 * l + 1) * ratio)
            values += p[:, None] * np.outer(np.cos(m * phi), coefficients[:, 0, l, m])
            values += p[:, None] * np.outer(np.sin(m * phi), coefficients[:, 1, l, m])
    return values


def sphericart(coefficients, d):
    """Y_lm = F_lm P_l^|m| Φ_m, P without the phase (Bigi et al. 2023, Eq. 1); the cosines go with m > 0."""
    bandlimit = math.isqrt(coefficients.shape[-1]) - 1
    phi, values = np.arctan2(d[:, 1], d[:, 0]), np.zeros((len(d), 3))
    for l in range(bandlimit + 1):
        for m in range(-l, l + 1):
            p = (-1) ** m * assoc_legendre_p(l, abs(m), d[:, 2])[0]
            ratio = math.factorial(l - abs(m)) / math.factorial(l + abs(m))
            f = math.sqrt((2 * l + 1) / (2 * math.pi) * ratio)
            turn = math.sqrt(0.5) if m == 0 else (np.cos(m * phi) if m > 0 else np.sin(-m * phi))
            values += np.outer(f * p * turn, coefficients[:, l * l + l + m])
    return values


def eval_sh(sh, d):
    """``eval_sh`` of utils/sh_utils.py of gaussian-splatting: sh (3, n²), up to degree 3."""
    c0, c1 = 0.28209479177387814, 0.4886025119029199
    c2 = [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396]
    c3 = [
        -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658,
        1.445305721320277, -0.5900435899266435,
    ]  # fmt: skip
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        c0 + 0 * x,
        -c1 * y, c1 * z, -c1 * x,
        c2[0] * x * y, c2[1] * y * z, c2[2] * (2 * zz - xx - yy), c2[3] * x * z, c2[4] * (xx - yy),
        c3[0] * y * (3 * xx - yy), c3[1] * x * y * z, c3[2] * y * (4 * zz - xx - yy),
        c3[3] * z * (2 * zz - 3 * xx - 3 * yy), c3[4] * x * (4 * zz - xx - yy), c3[5] * z * (xx - yy),
        c3[6] * x * (xx - 3 * yy),
    ]  # fmt: skip
    return np.stack(basis[: sh.shape[-1]], axis=1) @ sh.T


def gaussian_splatting(properties, d):
    """Colour along a view, of the properties of a .ply, read by their names as ``load_ply`` does."""
    names = [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(len(properties) - 3)]
    vertex = dict(zip(names, properties, strict=True))
    rest = np.array([vertex[f"f_rest_{i}"] for i in range(len(properties) - 3)])
    rest = rest.reshape(3, len(properties) // 3 - 1)  # (P, F, SH_coeffs except DC)
    dc = np.array([[vertex["f_dc_0"]], [vertex["f_dc_1"]], [vertex["f_dc_2"]]])
    return eval_sh(np.concatenate([dc, rest], axis=1), d) + 0.5


def khr_gaussian_splatting(coefficients, d):
    """Colour of KHR_gaussian_splatting, of attributes SH_DEGREE_l_COEF_n, n from the lowest order to the highest."""
    attributes, row = {}, 0
    for l in range(math.isqrt(len(coefficients))):
        for n in range(2 * l + 1):
            attributes[f"SH_DEGREE_{l}_COEF_{n}"] = coefficients[row]
            row += 1
    return eval_sh(np.stack(list(attributes.values()), axis=1), d) + 0.5
