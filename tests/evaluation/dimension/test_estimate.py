"""The effective dimension against the spectrum of caps, closed forms and brute force."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.evaluation.dimension import estimate
from slepian_prt.evaluation.dimension.estimate import (
    EffectiveDimension,
    dimension_of_energies,
    dimension_of_vectors,
    effective_dimension,
)
from slepian_prt.evaluation.dimension.neighbourhoods import Surface
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.scene.mitsuba.two_sides import with_back
from slepian_prt.scene.scene import Part
from slepian_prt.slepian.kernels import zonal_vectors
from slepian_prt.transport.transfer import Transfer
from tests.conftest import bumpy, random_directions, sphere
from tests.numerics import assert_exact


def transfer_of(mesh: Mesh, vectors: np.ndarray, bandlimit: int) -> Transfer:
    """Transfer whose vectors are given, (V, channels, M)."""
    return Transfer(
        vectors=vectors.astype(np.float32), axes=mesh.normals, mesh=mesh, parts=(), bandlimit=bandlimit, samples=1,
        seed=0, effects=(), bounces=0, rays_traced=0,
    )  # fmt: skip


def unshadowed(mesh: Mesh, kernel: np.ndarray) -> Transfer:
    """Transport with a zonal kernel about the normals."""
    return transfer_of(mesh, zonal_vectors(kernel, mesh.normals)[:, None], len(kernel) - 1)


def size_of(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.positions, axis=0)))


def smallest_count(energies: np.ndarray, error: float) -> int:
    """By the definition: how many, the largest first, leave no more than error² of all."""
    falling = sorted((float(e) for e in energies), reverse=True)
    return next(k for k in range(len(falling) + 1) if math.fsum(falling[k:]) <= error**2 * math.fsum(falling))


# --- Of given energies -----------------------------------------------------------------------------------------------


def test_rounded_up_it_is_the_smallest_number_of_functions(rng):
    for _ in range(50):
        energies = np.sort(np.exp(rng.uniform(-20.0, 0.0, size=rng.integers(1, 30))))[::-1]
        error = math.exp(rng.uniform(-6.0, -0.1))
        assert math.ceil(dimension_of_energies(energies, error)) == smallest_count(energies, error)


def test_it_is_linear_in_the_error_between_whole_numbers():
    """Of energies that fall by a constant q, K functions leave q^(K/2): the chord from one whole number to the next."""
    energies = 0.25 ** np.arange(200.0)
    for whole, part in ((1, 0.5), (4, 0.25), (7, 0.9), (3, 1.0)):
        error = 0.5**whole * (1.0 - part) + 0.5 ** (whole + 1) * part
        assert dimension_of_energies(energies, error) == pytest.approx(whole + part, rel=1e-12)


def test_noise_does_not_set_it_where_the_rank_is_finite(rng):
    """Two flat faces are of rank two: noise of a part s of the vectors moves r(1) and r(2) by s, so K by 2 s / r(1)."""
    normals = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], 50, axis=0)
    vectors = zonal_vectors(sp.cosine_lobe(10), normals).astype(np.float64)
    sigma = np.linalg.svd(vectors, compute_uv=False).tolist()
    expected = 2.0 - 0.05 / (sigma[1] / math.hypot(sigma[0], sigma[1]))
    size = math.sqrt(float(np.mean(vectors**2)))
    for noise in (0.0, 1e-7, 1e-5, 1e-3, 1e-2):
        noisy = vectors + noise * size * rng.normal(size=vectors.shape)
        found = dimension_of_vectors(noisy, np.ones(100), 0.05)
        assert found == pytest.approx(expected, abs=1e-6 + 2.0 * noise * math.hypot(sigma[0], sigma[1]) / sigma[1])


def test_one_function_and_none():
    assert dimension_of_energies(np.array([3.0, 0.0, -1e-17]), 0.05) == 1.0
    assert dimension_of_energies(np.array([1.0, 1e-9]), 0.9) == 1.0
    assert dimension_of_energies(np.zeros(4), 0.05) == 0.0


def test_of_vectors_it_is_that_of_their_singular_values(rng):
    """Fewer vectors than coefficients, and more; one channel and three, whose vectors all count."""
    for count, channels in ((7, 1), (60, 1), (60, 3)):
        vectors = rng.normal(size=(count, channels, 16)) * 0.4 ** np.arange(16)
        weights = rng.random(count)
        rows = (np.sqrt(weights)[:, None, None] * vectors).reshape(-1, 16)
        sigma = np.linalg.svd(rows, compute_uv=False)
        found = dimension_of_vectors(vectors, weights, 0.05)
        # Eigenvalues of the product of the matrix with itself are right to 16 ε of the largest, which is 1e-12 of the
        # part 0.0025 that is looked for.
        assert found == pytest.approx(dimension_of_energies(sigma**2, 0.05), abs=1e-9)
        if channels == 1:
            assert dimension_of_vectors(vectors[:, 0], weights, 0.05) == found
    none = dimension_of_vectors(vectors, np.zeros(60), 0.05)
    assert none == 0.0


# --- Of surfaces -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("exponent", "degrees", "error"), [(1.0, 20, 0.05), (1.0, 40, 0.05), (20.0, 40, 0.05)])
def test_on_a_sphere_it_is_that_of_the_transport_weighted_cap(exponent, degrees, error):
    """Eq. 8 of the paper: the energies are the eigenvalues of `cap_basis` with that kernel, to second order in h."""
    kernel, half_angle = sp.cosine_lobe(10, exponent), math.radians(degrees)
    expected = dimension_of_energies(sp.cap_basis(10, half_angle, kernel=kernel).eigenvalues, error)
    assert smallest_count(sp.cap_basis(10, half_angle, kernel=kernel).eigenvalues, error) == math.ceil(expected)
    off = []
    for subdivisions in (3, 4):
        mesh = sphere(subdivisions)
        found = effective_dimension(unshadowed(mesh, kernel), error, 2.0 * math.sin(half_angle / 2.0) / size_of(mesh))
        assert found.functions == 121
        assert found.radius == pytest.approx(2.0 * math.sin(half_angle / 2.0), rel=1e-12)
        off.append(float(np.abs(found.dimension - expected).max()))
    # h halves: a quarter is left of the error of a rule of second order, here with margin a half.
    assert off[1] < 0.5 * off[0]
    assert off[1] < 0.02 * expected


def plane(n: int) -> Mesh:
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return make_mesh(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces)


def test_an_open_plane_takes_one_function():
    result = effective_dimension(unshadowed(plane(20), sp.cosine_lobe(4)))
    assert_exact(result.dimension, np.ones(441), "r(1) is rounding, so the dimension is set to its least, one")
    assert result.quantile(0.5) == 1.0
    assert_exact(result.coherence, np.full(441, 1.0 - 1.0 / 25.0), "of the same ones")


def test_it_grows_with_the_radius_and_falls_with_the_error():
    transfer = unshadowed(sphere(3), sp.cosine_lobe(6))
    by_radius = [effective_dimension(transfer, neighbourhood=r).quantile(0.5) for r in (0.05, 0.1, 0.2, 0.4)]
    assert by_radius == sorted(by_radius)
    assert by_radius[-1] > 2.0 * by_radius[0]
    by_error = [effective_dimension(transfer, error, 0.2).quantile(0.5) for error in (0.2, 0.05, 0.01)]
    assert by_error == sorted(by_error)
    whole = effective_dimension(transfer, 0.05, 1.0)  # all in reach: every neighbourhood is the sphere
    energies = np.repeat(sp.cosine_lobe(6) ** 2, 2 * np.arange(7) + 1)
    # To the rounding of areas: those of an icosphere differ, which is 1 % of the energies of high degree.
    np.testing.assert_allclose(whole.dimension, dimension_of_energies(np.sort(energies)[::-1], 0.05), rtol=0.1)


@pytest.fixture(scope="module")
def ball() -> Transfer:
    """A self-shadowing ball, traced."""
    return sp.precompute(bumpy(4), bandlimit=6, samples=256)


def test_renumbered_vertices_change_nothing(ball, rng):
    """But for the order of sums, and a site where rounding decides what is in reach; neither is seen here."""
    shuffle = rng.permutation(len(ball.vectors))
    mesh = make_mesh(ball.positions[shuffle], np.argsort(shuffle)[ball.mesh.faces], normals=ball.normals[shuffle])
    again = effective_dimension(replace(ball, mesh=mesh, vectors=ball.vectors[shuffle]), neighbourhood=0.1)
    found = effective_dimension(ball, neighbourhood=0.1)
    np.testing.assert_allclose(again.dimension, found.dimension[shuffle], rtol=1e-9)


def test_a_turned_model_differs_by_where_neighbourhoods_are_taken(ball, rng):
    """SH rotate within their degrees, so that each neighbourhood keeps its dimension; sites are others."""
    axis = random_directions(rng, 2)
    turn = np.linalg.qr(np.stack([*axis, np.cross(*axis)], axis=1))[0]
    turn *= np.linalg.det(turn)
    mesh = make_mesh(ball.positions @ turn.T, ball.mesh.faces, normals=ball.normals @ turn.T)
    vectors = sp.rotate_sh(ball.vectors[:, 0].astype(np.float64), turn)[:, None]
    turned, radius = transfer_of(mesh, vectors, 6), 0.1 * size_of(ball.mesh)
    here, there = Surface(ball.mesh, radius), Surface(mesh, radius)
    for vertex in range(0, len(ball.vectors), 100):
        own, same = here.about(vertex), there.about(vertex)
        assert set(own.members.tolist()) == set(same.members.tolist())
        # To the rounding of float32, of vectors whose relative change of 6e-8 is far below the part 0.0025 left.
        assert dimension_of_vectors(turned.vectors[same.members], same.areas, 0.05) == pytest.approx(
            dimension_of_vectors(ball.vectors[own.members], own.areas, 0.05), rel=1e-4
        )
    kept = radius / size_of(mesh)  # the box of a turned model is another one
    again = effective_dimension(turned, neighbourhood=kept).dimension
    _assert_interpolated(again, effective_dimension(ball, neighbourhood=0.1).dimension)


def test_it_is_that_of_the_neighbourhood_of_each_vertex(ball, rng):
    """Brute force: sorted by distance, joined by a flood along edges, decomposed."""
    radius = 0.1 * size_of(ball.mesh)
    found = effective_dimension(ball, neighbourhood=0.1)
    edges, areas = ball.mesh.receivers.neighbours, found.areas
    chosen, expected = rng.choice(len(ball.vectors), 60, replace=False), []
    for vertex in chosen:
        near = np.linalg.norm(ball.positions - ball.positions[vertex], axis=1) < radius
        reached = np.zeros(len(near), dtype=bool)
        reached[vertex] = True
        while True:
            a, b = edges[near[edges].all(axis=1) & (reached[edges].sum(axis=1) == 1)].T
            if a.size == 0:
                break
            reached[a], reached[b] = True, True
        rows = np.sqrt(areas[reached])[:, None] * ball.vectors[reached, 0].astype(np.float64)
        expected.append(smallest_count(np.linalg.svd(rows, compute_uv=False) ** 2, 0.05))
    # What is rounded up is half a function more in the mean.
    assert np.mean(np.array(expected) - found.dimension[chosen]) == pytest.approx(0.5, abs=0.25)
    assert np.abs(np.array(expected) - found.dimension[chosen]).max() < 0.35 * max(expected) + 1.0


def test_a_finer_mesh_of_the_same_surface_gives_the_same():
    """Every face cut in four, transfer interpolated: vertices are four times as dense, the surface is the same."""
    mesh = bumpy(4)
    coarse = unshadowed(mesh, sp.cosine_lobe(6))
    edges = mesh.receivers.neighbours
    number = {tuple(edge): len(mesh.positions) + i for i, edge in enumerate(edges.tolist())}
    a, b, c = mesh.faces.T.tolist()
    ab, bc, ca = (
        [number[min(p, q), max(p, q)] for p, q in zip(u, v, strict=True)] for u, v in ((a, b), (b, c), (c, a))
    )
    faces = np.concatenate(
        [np.stack(corner, axis=1) for corner in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )

    def halved(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values[edges].mean(axis=1)])

    fine_mesh = make_mesh(halved(mesh.positions), faces, normals=halved(mesh.normals))
    fine = transfer_of(fine_mesh, halved(coarse.vectors), 6)
    found = effective_dimension(fine, neighbourhood=0.1).dimension[: len(mesh.positions)]
    _assert_interpolated(found, effective_dimension(coarse, neighbourhood=0.1).dimension)


def _assert_interpolated(actual: np.ndarray, expected: np.ndarray) -> None:
    """The same field, taken at other sites: off by some per cent in the mean, as between sites and in them."""
    off = np.abs(actual - expected) / expected
    assert np.sqrt(np.mean(off**2)) < 0.06
    assert np.quantile(off, 0.99) < 0.2


def test_three_channels_and_what_is_compressed(ball):
    """Three equal channels have the space of one; decoded vectors are those that are counted, to their tolerance."""
    found = effective_dimension(ball, neighbourhood=0.1).dimension
    three = replace(ball, vectors=np.repeat(ball.vectors, 3, axis=1))
    np.testing.assert_allclose(effective_dimension(three, neighbourhood=0.1).dimension, found, rtol=1e-9)
    packed = sp.compress(ball, tolerance=0.002, exact_mesh=True)  # so that sites are the same
    off = effective_dimension(packed, neighbourhood=0.1).dimension / found - 1.0
    assert np.sqrt(np.mean(off**2)) < 0.02


def test_dark_and_unused_vertices_count_for_nothing(ball):
    dark = replace(ball, vectors=np.zeros_like(ball.vectors))
    result = effective_dimension(dark, neighbourhood=0.2)
    assert_exact(result.dimension, np.zeros(len(ball.vectors)), "no light arrives")
    assert result.quantile(0.5) == 0.0
    mesh = make_mesh(np.concatenate([ball.positions, [[9.0, 9.0, 9.0]]]), ball.mesh.faces)
    stray = replace(ball, mesh=mesh, vectors=np.concatenate([ball.vectors, ball.vectors[:1]]))
    found = effective_dimension(stray, neighbourhood=0.2)
    assert found.dimension[-1] == 0.0
    assert found.radius == result.radius  # no face uses it: the model is no larger


def test_darkness_is_no_low_dimension_to_go_over_into(ball):
    """Half of a ball dark: what is lit is of at least one function up to the border, what is dark of none."""
    vectors, dark = ball.vectors.copy(), ball.positions[:, 0] < 0.0
    vectors[dark] = 0.0
    found = effective_dimension(replace(ball, vectors=vectors), neighbourhood=0.1)
    assert_exact(found.dimension[dark], np.zeros(int(dark.sum())), "no light arrives")
    assert found.dimension[~dark].min() >= 1.0
    none = effective_dimension(replace(ball, vectors=np.zeros_like(vectors)), neighbourhood=0.2)
    assert "median='none, no light arrives anywhere', error=" in repr(none)
    assert "coherence" not in repr(none)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_vectors_that_are_not_finite(ball, wrong):
    vectors = ball.vectors.copy()
    vectors[[7, 90], 0, 3] = wrong
    said = r"^the transfer vectors of 2 of 2562 vertices are not finite, the first of vertex 7; precompute"
    with pytest.raises(sp.UserError, match=said):
        effective_dimension(replace(ball, vectors=vectors))


def test_progress_reaches_its_total(ball):
    """Of vertices that faces use, each once; calls are many, as sites are."""
    mesh = make_mesh(np.concatenate([ball.positions, [[9.0, 9.0, 9.0]]]), ball.mesh.faces)
    stray = replace(ball, mesh=mesh, vectors=np.concatenate([ball.vectors, ball.vectors[:1]]))
    told: list[tuple[int, int]] = []
    effective_dimension(stray, neighbourhood=0.2, advance=lambda done, total: told.append((done, total)))
    assert sum(done for done, _ in told) == len(ball.vectors)
    assert {total for _, total in told} == {len(ball.vectors)}
    assert len(told) > 50


def test_all_blocks_of_vectors_count(rng, monkeypatch):
    """More vectors than are multiplied at once, whose second half adds functions to the first."""
    monkeypatch.setattr(estimate, "_ROWS", 50)
    vectors = np.zeros((120, 8))
    vectors[:60, :2], vectors[60:, 2:] = rng.normal(size=(60, 2)), rng.normal(size=(60, 6))
    sigma = np.linalg.svd(vectors, compute_uv=False)
    found = dimension_of_vectors(vectors, np.ones(120), 0.05)
    assert found == pytest.approx(dimension_of_energies(sigma**2, 0.05), abs=1e-9)
    assert found > 7.0


def test_pixels_of_a_camera_are_no_surface(ball):
    pixels = replace(ball, film=SimpleNamespace(name="front"))
    with pytest.raises(sp.UserError, match=r"pixels of camera 'front', which are no surface .* precompute the scene"):
        effective_dimension(pixels)


def test_quantiles_are_of_the_area():
    result = EffectiveDimension(np.array([1.0, 4.0, 9.0, 0.0]), 25, 0.05, 1.0, 0.1, np.array([1.0, 2.0, 7.0, 90.0]), 3)
    assert [result.quantile(part) for part in (0.0, 0.05, 0.15, 0.5, 1.0)] == [1.0, 1.0, 4.0, 9.0, 9.0]
    assert repr(result) == ("EffectiveDimension(vertices=4, median='9 of 25', coherence=0.64, error=0.05, radius=1)")


def test_of_two_sides_the_front_counts(ball):
    """Backs have a dimension of their own, in neighbourhoods of their own, but no area."""
    mesh = ball.mesh
    both = with_back(mesh, mesh.albedo)
    count, back = len(mesh.positions), np.zeros_like(ball.vectors)
    back[:, 0, 0] = 1.0
    two = replace(ball, mesh=both, vectors=np.concatenate([ball.vectors, back]), parts=(Part("ball", 0, count, 2),))
    found, front = effective_dimension(two, neighbourhood=0.1), effective_dimension(ball, neighbourhood=0.1)
    assert_exact(found.dimension[count:], np.ones(count), "one function is all that backs have")
    assert_exact(found.areas[count:], np.zeros(count), "none")
    assert_exact(found.areas[:count], front.areas, "the same sums")
    # Neighbourhoods begin at other vertices, which is some per cent of a dimension.
    assert found.quantile(0.5) == pytest.approx(front.quantile(0.5), rel=0.06)
    assert found.quantile(0.01) > 1.0


@pytest.mark.parametrize("part", [-1, 2, 1.0000001, math.nan, [0.5], np.linspace(0, 1, 99), "half", None])
def test_parts_of_a_surface_that_are_none(part):
    result = EffectiveDimension(np.array([1.0, 4.0]), 25, 0.05, 1.0, 0.1, np.array([1.0, 2.0]), 3)
    with pytest.raises(sp.UserError, match=r"^part must be a number in \[0, 1\], not .{1,80}$"):
        result.quantile(part)


@pytest.mark.parametrize("error", [0.0, 1.0, -0.1, 1e-6, math.nan, "much", None])
def test_errors_that_are_none(ball, error):
    with pytest.raises(sp.UserError, match=r"^error must be a number in \[1e-05, 1\), not "):
        effective_dimension(ball, error)


@pytest.mark.parametrize("neighbourhood", [0.0, 1.5, math.nan, "wide"])
def test_neighbourhoods_that_are_none(ball, neighbourhood):
    with pytest.raises(sp.UserError, match=r"^neighbourhood must be a number in \(0, 1\]"):
        effective_dimension(ball, neighbourhood=neighbourhood)
