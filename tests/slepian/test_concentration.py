import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import jv

from slepian_prt.errors import UserError
from slepian_prt.slepian.concentration import cap_basis, cap_moment_factors
from slepian_prt.slepian.kernels import cosine_lobe, measured_moment, zonal_moment
from slepian_prt.slepian.region_concentration import region_basis
from slepian_prt.slepian.shannon import shannon_number
from slepian_prt.sphere.caps import cap_area
from slepian_prt.sphere.harmonics import degrees, legendre_polynomials, num_coefficients, real_sh
from slepian_prt.sphere.quadrature import cap_nodes, cap_rule
from slepian_prt.sphere.regions import cap_region
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from tests.conftest import random_directions
from tests.numerics import assert_exact, assert_rounded

HALF_ANGLES = [1e-4, 0.01, 0.35, math.pi / 2, 2.8, math.pi]


@pytest.mark.parametrize("half_angle", HALF_ANGLES)
@pytest.mark.parametrize("bandlimit", [0, 1, 2, 5, 10, 50, 100, 200])
def test_basis_of_a_cap(bandlimit, half_angle):
    basis = cap_basis(bandlimit, half_angle)
    assert len(basis) == num_coefficients(bandlimit)
    eigenvalues, leakages = basis.eigenvalues, basis.leakages
    assert np.isfinite(eigenvalues).all()
    assert eigenvalues.min() >= 0.0
    assert eigenvalues.max() <= 1.0
    assert leakages.min() >= 0.0
    np.testing.assert_allclose(eigenvalues + leakages, 1.0, atol=1e-13)
    assert eigenvalues.sum() == pytest.approx(shannon_number(bandlimit, half_angle), rel=1e-12)
    nodes = cap_nodes(bandlimit + 1, half_angle)
    for m in {0, 1, bandlimit // 3, bandlimit} if bandlimit >= 3 else range(bandlimit + 1):
        v = basis.blocks[m]
        assert np.abs(v.T @ v - np.eye(v.shape[1])).max() <= 1e-12
        # Orthogonal on the cap.
        y = (legendre_polynomials(bandlimit, m, nodes.z, nodes.z_low) * nodes.sine**m).T @ v
        gram = (y * (nodes.weights * (2 * math.pi if m == 0 else math.pi))[:, None]).T @ y
        assert np.abs(gram - np.diag(np.diag(gram))).max() <= 1e-12
        own = eigenvalues[(basis.orders == m)]
        assert np.abs(np.diag(gram) - own).max() <= 1e-12


def test_limits_at_zero_and_pi():
    for bandlimit in (0, 4, 30):
        assert (cap_basis(bandlimit, 0.0).eigenvalues == 0.0).all()
        assert (cap_basis(bandlimit, 0.0).leakages == 1.0).all()
        assert (cap_basis(bandlimit, math.pi).eigenvalues == 1.0).all()
        # As Θ → 0 the first function is the one that is largest at the centre: proportional to y_lm(z).
        first = cap_basis(bandlimit, 0.0).functions[:, 0]
        at_pole = real_sh(bandlimit, [0, 0, 1])[0]
        np.testing.assert_allclose(first, at_pole / np.linalg.norm(at_pole), atol=1e-12)


def localisation_block_mpmath(bandlimit: int, m: int, half_angle: mpmath.mpf) -> mpmath.matrix:
    """Localisation matrix of one order by Gauss–Legendre quadrature at the working precision."""
    n = bandlimit + 1
    size = bandlimit + 1 - m
    nodes = []
    for i in range(1, n + 1):
        x = mpmath.cos(mpmath.pi * (i - mpmath.mpf("0.25")) / (n + mpmath.mpf("0.5")))
        for _ in range(9):
            p0, p1 = mpmath.mpf(1), x
            for k in range(2, n + 1):
                p0, p1 = p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k
            slope = n * (x * p1 - p0) / (x * x - 1)
            x -= p1 / slope
        nodes.append((x, 2 / ((1 - x * x) * slope * slope)))
    low = mpmath.cos(half_angle)
    matrix = mpmath.matrix(size)
    for x, w in nodes:
        z = low + (1 - low) * (1 + x) / 2
        s = mpmath.sqrt(1 - z * z)
        values = (
            [mpmath.sqrt(mpmath.mpf(2 * m + 1) / 2 * mpmath.fac2(2 * m - 1) / mpmath.fac2(2 * m)) * s**m]
            if m
            else [mpmath.sqrt(mpmath.mpf(1) / 2)]
        )
        for l in range(m + 1, bandlimit + 1):
            a = mpmath.sqrt(mpmath.mpf(4 * l * l - 1) / (l * l - m * m))
            value = z * values[-1]
            if l > m + 1:
                value -= mpmath.sqrt(mpmath.mpf((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) * values[-2]
            values.append(a * value)
        weight = w * (1 - low) / 2
        for i in range(size):
            for j in range(i + 1):
                matrix[i, j] += weight * values[i] * values[j]
    for i in range(size):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return matrix


@pytest.mark.slow
@pytest.mark.parametrize(
    ("half_angle", "m", "digits"),
    # Enough digits to tell apart the smallest concentrations.
    [(0.35, 0, 400), (0.35, 7, 200), (math.pi / 2, 3, 90), (1.2, 20, 90), (0.05, 30, 400), (2.8, 11, 200)],
)
def test_eigenvectors_against_mpmath_at_bandlimit_50(half_angle, m, digits):
    bandlimit = 50
    with mpmath.workdps(digits):
        matrix = localisation_block_mpmath(bandlimit, m, mpmath.mpf(half_angle))
        exact_values, exact_vectors = mpmath.eigsy(matrix)
    basis = cap_basis(bandlimit, half_angle)
    block, own = basis.blocks[m], basis.eigenvalues[basis.orders == m]
    size = bandlimit + 1 - m
    for j in range(size):
        column = size - 1 - j
        exact = np.array([float(exact_vectors[i, column]) for i in range(size)])
        ours = block[:, j]
        exact *= np.sign(exact @ ours)
        assert np.abs(exact - ours).max() <= 1e-12, f"eigenvector {j}"
        value = exact_values[column]
        if value > 1e-24:
            assert abs(float(value) / own[j] - 1) <= 0.01, f"eigenvalue {j}"
        leak = 1 - value
        if leak < 0.5 and leak > 1e-24:
            assert abs(float(leak) / basis.leakages[basis.orders == m][j] - 1) <= 0.01, f"leakage {j}"


def test_against_pyshtools():
    pyshtools = pytest.importorskip("pyshtools")
    bandlimit, half_angle = 20, 0.6
    _, theirs, _ = pyshtools.spectralanalysis.SHReturnTapers(half_angle, bandlimit)
    np.testing.assert_allclose(cap_basis(bandlimit, half_angle).eigenvalues, np.sort(theirs)[::-1], atol=1e-12)


@pytest.mark.slow
def test_order_and_signs_are_deterministic():
    first, second = cap_basis(60, 0.5), cap_basis(60, 0.5)
    assert_exact(first.orders, second.orders, because="integers, by the same calls")
    assert_rounded(first.radial, second.radial, terms=61, size=1.0)
    # Within one order the ranks ascend, also where the concentrations are below rounding.
    for m in (0, 5, -5, 40):
        assert (np.diff(first.ranks[first.orders == m]) > 0).all()
    # +m and -m stand next to each other as long as nothing is tied.
    assert (np.diff(first.eigenvalues) <= 1e-15).all()
    assert first.functions[:, 0] @ real_sh(60, first.center)[0] > 0


@given(st.integers(0, 12), st.floats(0.0, math.pi), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_any_center(bandlimit, half_angle, seed):
    rng = np.random.default_rng(seed)
    center = random_directions(rng, 1)[0]
    basis = cap_basis(bandlimit, half_angle, center)
    g = basis.functions
    np.testing.assert_allclose(g.T @ g, np.eye(len(basis)), atol=1e-12)
    directions, weights = cap_rule(2 * bandlimit, half_angle, center)
    values = real_sh(bandlimit, directions) @ g
    gram = (values * weights[:, None]).T @ values
    np.testing.assert_allclose(gram, np.diag(basis.eigenvalues), atol=1e-12)


@pytest.mark.parametrize("threshold", [0.5, 1e-3, 1e-9])
@pytest.mark.parametrize("half_angle", [0.01, 0.35, 2.5])
def test_threshold_gives_the_head_of_the_full_basis(threshold, half_angle):
    full, head = cap_basis(40, half_angle), cap_basis(40, half_angle, threshold=threshold)
    count = int((full.eigenvalues > threshold).sum())
    assert len(head) == count
    # Where concentrations are the same to rounding, so may be their order.
    ties = np.cumsum(np.diff(full.eigenvalues[:count], prepend=1.0) < -1e-13)
    orders = [basis.orders[:count][np.lexsort((basis.orders[:count], ties))] for basis in (head, full)]
    assert_exact(*orders, because="integers")
    np.testing.assert_allclose(head.eigenvalues, full.eigenvalues[:count], atol=1e-13)
    np.testing.assert_allclose(head.radial, full.radial[:count], atol=1e-12)


def test_radially_symmetric_functions_are_those_of_order_zero():
    full, radial = cap_basis(15, 0.7), cap_basis(15, 0.7, radially_symmetric=True)
    zero = full.orders == 0
    np.testing.assert_allclose(radial.eigenvalues, full.eigenvalues[zero], atol=1e-14)
    assert len(radial) == 16


# --- Kernels ---------------------------------------------------------------------------------------------------------


def second_moment_by_quadrature(bandlimit, half_angle, center, vectors):
    """C_U by brute force: vectors (k, M) in their own frame, averaged over azimuth and mirroring, turned to normals."""
    normals, weights = cap_rule(2 * bandlimit, half_angle, center)
    turns = 2 * math.pi * np.arange(2 * bandlimit + 1) / (2 * bandlimit + 1)
    total = np.zeros((num_coefficients(bandlimit),) * 2)
    mirror = np.where(np.concatenate([np.arange(-l, l + 1) for l in range(bandlimit + 1)]) < 0, -1.0, 1.0)
    averaged = []
    for turn in turns:
        c, s = math.cos(turn), math.sin(turn)
        about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        averaged += [rotate_sh(vectors, about_z), rotate_sh(vectors * mirror, about_z)]
    local = np.concatenate(averaged) / math.sqrt(2 * len(turns) * len(vectors))
    for n, w in zip(normals, weights, strict=True):
        turned = rotate_sh(local, rotation_to(n))
        total += w * turned.T @ turned
    return total / cap_area(half_angle)


@pytest.mark.parametrize("half_angle", [0.25, 1.4])
def test_general_second_moment_against_brute_force(half_angle, rng):
    bandlimit, center = 4, np.array([0.36, 0.48, 0.8])
    vectors = rng.normal(size=(3, num_coefficients(bandlimit)))
    expected = second_moment_by_quadrature(bandlimit, half_angle, center, vectors)
    basis = cap_basis(bandlimit, half_angle, center, kernel=measured_moment(vectors))
    g = basis.functions
    np.testing.assert_allclose(g @ np.diag(basis.eigenvalues) @ g.T, expected, atol=1e-12 * expected.max() * 10)
    np.testing.assert_allclose(g.T @ g, np.eye(len(basis)), atol=1e-12)


def test_zonal_kernel_is_a_special_second_moment():
    zonal = cosine_lobe(8)
    direct = cap_basis(8, 0.6, kernel=zonal)
    general = cap_basis(8, 0.6, kernel=zonal_moment(zonal))
    np.testing.assert_allclose(direct.eigenvalues, general.eigenvalues, atol=1e-15)
    # Energy is conserved: Σ λ = Σ_l t_l² (2l+1)/4π.
    energy = (zonal[degrees(8)] ** 2).sum() / (4 * math.pi)
    assert direct.eigenvalues.sum() == pytest.approx(energy, rel=1e-13)


def test_flat_kernel_gives_the_plain_problem():
    plain, flat = cap_basis(9, 0.5), cap_basis(9, 0.5, kernel=np.ones(10))
    np.testing.assert_allclose(flat.eigenvalues * cap_area(0.5), plain.eigenvalues, atol=1e-14)


def test_kernel_on_a_cap_of_no_size():
    zonal = cosine_lobe(6)
    basis = cap_basis(6, 0.0, center=[0, 1, 0], kernel=zonal)
    vector = real_sh(6, [0, 1, 0])[0] * zonal[degrees(6)]
    assert basis.eigenvalues[0] == pytest.approx(vector @ vector, rel=1e-13)
    assert basis.eigenvalues[1:].max() <= 1e-28
    np.testing.assert_allclose(np.abs(basis.functions[:, 0]), np.abs(vector) / np.linalg.norm(vector), atol=1e-13)


def test_null_space_is_ordered_by_the_incident_cap():
    """Odd degrees, which the clamped cosine lacks, come after the others, most concentrated first."""
    bandlimit, half_angle = 7, 0.3
    basis = cap_basis(bandlimit, half_angle, kernel=cosine_lobe(bandlimit))
    null = basis.eigenvalues == 0.0
    odd = (degrees(bandlimit) % 2 == 1) & (degrees(bandlimit) > 1)
    assert null.sum() >= odd.sum()
    directions, weights = cap_rule(2 * bandlimit, half_angle + math.pi / 2)
    y = real_sh(bandlimit, directions) @ basis.functions[:, null]
    inside = (weights[:, None] * y**2).sum(axis=0)
    for m in range(bandlimit + 1):
        assert (np.diff(inside[basis.orders[null] == m]) <= 1e-12).all()


def test_moment_factors_reproduce_the_moment(rng):
    zonal = cosine_lobe(5)
    normals, weights = cap_rule(10, 0.9)
    t = real_sh(5, normals) * zonal[degrees(5)]
    expected = (t * weights[:, None]).T @ t / cap_area(0.9)
    l = np.arange(6)
    for m, factor in enumerate(cap_moment_factors(5, 0.9, zonal)):
        column = (l * (l + 1))[m:]
        for sign in (1, -1):
            index = column + sign * m
            np.testing.assert_allclose(factor.T @ factor, expected[np.ix_(index, index)], atol=1e-15)


# --- Statements of the paper -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("terms", [1, 4, 9, 20])
def test_error_identity(terms, rng):
    """‖B - B̃‖²_U = Σ_{i>K} b̄_i² λ_i (Lessig & Fiume, Sec. 3) for unoccluded diffuse light."""
    bandlimit, half_angle, center = 6, 0.7, np.array([0.0, 0.6, 0.8])
    basis = cap_basis(bandlimit, half_angle, center)
    b = cosine_lobe(bandlimit)[degrees(bandlimit)] * rng.normal(size=num_coefficients(bandlimit))
    coefficients = basis.functions.T @ b
    rest = basis.functions[:, terms:] @ coefficients[terms:]
    directions, weights = cap_rule(2 * bandlimit, half_angle, center)
    squared = weights @ (real_sh(bandlimit, directions) @ rest) ** 2
    assert squared == pytest.approx((coefficients[terms:] ** 2 * basis.eigenvalues[terms:]).sum(), rel=1e-10)


@pytest.mark.parametrize("terms", [3, 9, 16])
def test_no_other_linear_basis_is_better_for_white_light(terms, rng):
    bandlimit, half_angle = 8, 0.8
    basis = cap_basis(bandlimit, half_angle)
    directions, weights = cap_rule(2 * bandlimit, half_angle)
    y = real_sh(bandlimit, directions)
    localisation = (y * weights[:, None]).T @ y

    def mean_error(functions: np.ndarray) -> float:
        # Mean over white b of ‖b - P b‖²_U with P the orthogonal projection in coefficient space.
        rest = np.eye(len(functions)) - functions @ functions.T
        return float(np.trace(rest @ localisation @ rest))

    ours = mean_error(basis.functions[:, :terms])
    assert ours == pytest.approx(basis.eigenvalues[terms:].sum(), rel=1e-10)
    assert mean_error(np.eye(len(basis))[:, :terms]) > ours
    for scale in (1e-3, 0.1, 10.0):
        for _ in range(10):
            other = np.linalg.qr(basis.functions[:, :terms] + scale * rng.normal(size=(len(basis), terms)))[0]
            assert mean_error(other) >= ours * (1 - 1e-12)


def test_plane_limit():
    """As Θ → 0 at fixed c = (L+1)Θ the order-m problem becomes Slepian's (1964): ∫₀¹ J_m(c r s) √(rs) … ds.

    The disc's concentrations are λ = c γ² with γ the eigenvalues of the Hankel kernel J_m(c r s) √(c r s) on [0, 1].
    """
    c = 6.0
    x, w = np.polynomial.legendre.leggauss(60)
    r, w = 0.5 * (x + 1), 0.5 * w
    previous = None
    for bandlimit in (29, 119, 479):
        half_angle = c / (bandlimit + 1)
        basis = cap_basis(bandlimit, half_angle, threshold=1e-6)
        worst = 0.0
        for m in (0, 1, 4):
            kernel = jv(m, c * np.outer(r, r)) * np.sqrt(c * np.outer(r, r)) * np.sqrt(np.outer(w, w))
            gamma = np.linalg.eigvalsh(kernel)
            disc = np.sort(c * gamma**2)[::-1]
            own = basis.eigenvalues[basis.orders == m]
            worst = max(worst, np.abs(own[:3] - disc[:3]).max())
        # The difference falls as Θ²: by at least 10 for a quarter of the angle.
        assert previous is None or worst <= previous / 10
        previous = worst
    assert previous <= 1e-4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1, 0.5), "bandlimit"),
        ((2.5, 0.5), "bandlimit"),
        ((3, -0.1), "half_angle"),
        ((3, 3.2), "half_angle"),
        ((3, float("nan")), "half_angle"),
        ((3, 0.5, [0, 0, 0]), "center"),
        ((3, 0.5, [0, 0, 1], [1.0, 2.0]), "kernel"),
        ((3, 0.5, [0, 0, 1], zonal_moment(np.ones(3))), "kernel"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        cap_basis(*arguments)


@pytest.mark.parametrize("terms", [0, 17, 2.0, True])
def test_bad_terms(terms):
    with pytest.raises(ValueError, match=r"terms must be an integer in \[1, 16\]"):
        cap_basis(3, 0.5, terms=terms)


@pytest.mark.parametrize("kernel", [None, cosine_lobe(5)])
def test_first_terms(kernel):
    full, head = cap_basis(5, 0.5, kernel=kernel), cap_basis(5, 0.5, kernel=kernel, terms=7)
    assert len(head) == 7
    # Unit vectors, turned degree by degree: sums of up to 2 L + 1 products, Σ |x y| ≤ |x| |y| = 1.
    assert_rounded(head.functions, full.functions[:, :7], terms=11, size=1.0)
    # Concentrations of at most one: sums over L + 1 nodes of squares of up to L + 1 products.
    assert_rounded(head.eigenvalues, full.eigenvalues[:7], terms=6 + 2 * 6, size=1.0)


@pytest.mark.parametrize("threshold", ["x", True, -0.1, math.nan])
@pytest.mark.parametrize(
    "solve",
    [
        lambda x: cap_basis(3, 0.5, threshold=x),
        lambda x: region_basis(3, cap_region((0, 0, 1), 0.5), threshold=x),
    ],
)
def test_bad_thresholds(solve, threshold):
    with pytest.raises(UserError, match=r"threshold must be a number in \[0, inf\], not"):
        solve(threshold)
