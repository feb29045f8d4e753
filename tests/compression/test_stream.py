import dataclasses
import inspect
import math
from itertools import pairwise

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.bases import ANALYTIC, BASES, Frame, Problem, candidates, shared_half_angle
from slepian_prt.compression.clustering import cluster_axes, spread
from slepian_prt.compression.decoder import coded_along_principal_axes
from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.pilot import PILOT_SIZE, learn, pilot_vertices
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress, compress_scene
from slepian_prt.compression.tolerance_sweep import ToleranceSweep
from slepian_prt.compression.truncation import by_tolerance, predicted_error, tails
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.slepian.shannon import concentration_count, generalized_shannon_number, refined_shannon_number
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, inside_out, sphere
from tests.numerics import assert_exact, assert_rounded

# `slepian` lacks the odd degrees; of K terms `pca` spends one on the mean.
COMPLETE = [name for name in ANALYTIC if name != "slepian"]


NO_TOLERANCES = (0.0, 1.0, 1, 2, -0.1, math.nan, math.inf, True, "0.1")


def error(packed, transfer) -> float:
    reference = transfer.vectors[:, 0]
    return float(np.linalg.norm(packed.reconstruct()[:, 0] - reference) / np.linalg.norm(reference))


def problem_of(transfer, count: int) -> Problem:
    clusters = cluster_axes(transfer.normals, count)
    vertices = pilot_vertices(clusters, transfer.normals, 0)
    pilot = learn(clusters, transfer.normals, vertices, transfer.vectors[vertices])
    frames = [
        Frame(cap.center, cap.half_angle, spread(cap.center, transfer.normals[members]), 0)
        for cap, members in zip(clusters.caps, clusters.members, strict=True)
    ]
    return Problem(transfer.bandlimit, tuple(frames), pilot)


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


@pytest.fixture(scope="module")
def convex():
    return precompute(sphere(5), bandlimit=6, samples=16)


@pytest.mark.parametrize("basis", COMPLETE)
def test_all_terms_give_full_sh(basis, shadowed):
    packed = compress(shadowed, basis, terms=49, clusters=10)
    assert error(packed, shadowed) <= 1e-5
    assert packed.predicted_error <= 1e-6


@pytest.mark.parametrize("basis", COMPLETE)
def test_error_falls_with_terms(basis, shadowed):
    errors = [error(compress(shadowed, basis, terms=k, clusters=10), shadowed) for k in (1, 4, 9, 16, 25, 36)]
    assert all(later <= earlier * (1 + 1e-6) for earlier, later in pairwise(errors))


@pytest.mark.parametrize("channels", [1, 3])
def test_vectors_come_back_in_the_shape_that_they_had(shadowed, channels):
    """(V, channels, M) everywhere, so that what takes the one takes the other."""
    whole = dataclasses.replace(shadowed, vectors=np.repeat(shadowed.vectors, channels, axis=1))
    packed = compress(whole, "none")
    assert packed.reconstruct().shape == whole.vectors.shape
    assert packed.reconstruct(np.array([5, 2])).shape == (2, channels, 49)
    np.testing.assert_allclose(packed.reconstruct(), whole.vectors, atol=1e-6)


def test_none_keeps_everything(shadowed):
    packed = compress(shadowed, "none")
    np.testing.assert_allclose(packed.reconstruct()[:, 0], shadowed.vectors[:, 0], atol=1e-6)
    assert packed.terms == 49
    assert packed.basis == "none"


@pytest.fixture(scope="module")
def filled_cap():
    """A piece of a sphere whose normals fill one cap evenly, as the model of the cap has it."""
    ball = sphere(6)
    inside = ball.positions @ np.array([0.0, 0.6, 0.8]) > math.cos(0.4)
    faces = ball.faces[inside[ball.faces].all(axis=1)]
    used, renamed = np.unique(faces, return_inverse=True)
    return precompute(
        make_mesh(ball.positions[used], renamed.reshape(-1, 3), normals=ball.positions[used]), bandlimit=6, samples=16
    )


@pytest.mark.parametrize("basis", ["adapted", "transport", "slepian", "incident", "sh"])
@pytest.mark.parametrize("terms", [1, 4, 9])
def test_prediction_for_unoccluded_light(basis, terms, filled_cap):
    """On a sphere the model of transport is exact; what is left is how evenly its vertices fill the cap."""
    assert filled_cap.rays_traced == 0
    packed = compress(filled_cap, basis, terms=terms, clusters=1)
    # The shared half-angle is up to 2 % wider; an error of order j in the angle grows by (1.02)^j, j <= 3 here. The
    # outermost ring of the mesh ends up to one edge, 0.02 rad or 5 %, inside the cap.
    assert packed.predicted_error == pytest.approx(error(packed, filled_cap), rel=0.12)


@pytest.mark.parametrize("basis", ["adapted", "transport", "slepian", "incident", "sh", "pca", "direct"])
@pytest.mark.parametrize("terms", [4, 16])
def test_prediction_for_shadowed_light(basis, terms, shadowed):
    packed = compress(shadowed, basis, terms=terms, clusters=24)
    assert packed.predicted_error == pytest.approx(error(packed, shadowed), rel=0.1)


def test_prediction_weights_of_slepian_follow_the_identity(convex):
    """Paper, Sec. 3: with unoccluded transport the span of D_t g_i misses what the later functions carry."""
    for candidate in candidates("slepian", problem_of(convex, 6)):
        assert candidate.energies.sum() == pytest.approx(candidate.total, rel=1e-6)
        assert tails(candidate)[-1] <= 1e-6 * candidate.total


def test_slepian_functions_are_the_images_of_the_papers(convex):
    """The K-th span equals span{D_t g_i, i <= K} of the cap's own Slepian functions."""
    from slepian_prt.slepian.concentration import cap_basis
    from slepian_prt.slepian.kernels import cosine_lobe
    from slepian_prt.sphere.harmonics import degrees

    packed = compress(convex, "slepian", terms=5, clusters=3)
    for cap, basis in zip(packed.clusters.caps, packed.bases, strict=True):
        g = cap_basis(6, shared_half_angle(cap.half_angle), cap.center).functions[:, :5]
        image = g * cosine_lobe(6)[degrees(6)][:, None]
        inside = basis.functions @ image
        np.testing.assert_allclose(np.linalg.norm(inside, axis=0), np.linalg.norm(image, axis=0), rtol=1e-5)


def test_projecting_on_the_normal_caps_functions_is_the_trap(shadowed):
    assert error(compress(shadowed, "direct", terms=9), shadowed) > 2 * error(
        compress(shadowed, "sh", terms=9), shadowed
    )


def test_adapted_beats_sh_and_stays_behind_cpca(shadowed):
    at_nine = {basis: error(compress(shadowed, basis, terms=9), shadowed) for basis in ("adapted", "sh", "cpca")}
    assert at_nine["cpca"] <= at_nine["adapted"] < 0.7 * at_nine["sh"]


@pytest.mark.parametrize("basis", ["adapted", "transport", "slepian", "incident", "sh", "cpca"])
@pytest.mark.parametrize("tolerance", [0.3, 0.1, 0.02])
@pytest.mark.parametrize("coding", ["coded", "float32"])
def test_tolerance_is_kept(basis, tolerance, coding, shadowed):
    packed = compress(shadowed, basis, tolerance=tolerance, clusters=16, coding=coding)
    full = basis == "slepian"  # not complete: may run out of functions
    assert packed.predicted_error <= tolerance * (1 + 1e-9) or full
    if full:
        return
    vectors = shadowed.vectors[:, 0].astype(np.float64)
    missed, energy = ((each**2).sum(axis=1) for each in (packed.reconstruct()[:, 0] - vectors, vectors))
    found = missed.sum() / energy.sum()
    # Without coding nothing is measured on all vertices: the pilot foretells it, which is a sample of them.
    deviation = np.std(missed - found * energy) / math.sqrt(PILOT_SIZE) / energy.mean()
    assert found <= tolerance**2 + (3.0 * deviation if coding == "float32" else 0.2 * tolerance**2)


def test_tolerance_takes_the_fewest(shadowed):
    problem = problem_of(shadowed, 8)
    found = candidates("adapted", problem)
    sizes = cluster_axes(shadowed.normals, 8).sizes
    terms = by_tolerance(found, sizes, 0.1)
    assert predicted_error(found, terms, sizes) <= 0.1
    # The weakest functions that are kept (two of them, m and -m, may be tied) could not be left out.
    weakest = min(f.energies[k - 1] for f, k in zip(found, terms, strict=True))
    fewer = np.array([int((f.energies > weakest * (1 + 1e-9)).sum()) for f in found])
    assert predicted_error(found, fewer, sizes) > 0.1


def test_impossible_tolerance_keeps_all(shadowed):
    packed = compress(shadowed, "slepian", tolerance=1e-9, clusters=4, coding="float32")
    assert all(basis.count == 31 for basis in packed.bases)  # degrees 0, 1, 2, 4, 6


@pytest.mark.parametrize("rule", ["n_g", "n_ref", "count"])
def test_shannon_truncation(rule, convex):
    packed = compress(convex, "slepian", truncate=rule, epsilon=0.01, clusters=20)
    number = {"n_g": generalized_shannon_number, "n_ref": refined_shannon_number, "count": concentration_count}[rule]
    wanted = [max(1, math.ceil(number(6, cap.half_angle, 0.01))) for cap in packed.clusters.caps]
    assert [basis.count for basis in packed.bases] == wanted
    # Leaving out concentrations below 1 % leaves an error of that order.
    assert error(packed, convex) < 0.1


def test_float16_costs_half_and_a_little_accuracy(shadowed):
    whole, half = (compress(shadowed, terms=16, clusters=8, coding=c) for c in ("float32", "float16"))
    assert half.bytes_per_vertex < 0.6 * whole.bytes_per_vertex
    assert abs(error(half, shadowed) - error(whole, shadowed)) < 1e-3


# --- Hard cases ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", [*BASES, "none"])
def test_closed_room_is_compressed_to_nothing(basis):
    transfer = precompute(inside_out(sphere(2)), bandlimit=3, samples=64)
    black = type(transfer)(**{**transfer.__dict__, "vectors": np.zeros_like(transfer.vectors)})
    packed = compress(black, basis, **({} if basis == "none" else {"terms": 4}))
    assert not packed.reconstruct().any()
    assert packed.predicted_error == 0.0


@pytest.mark.parametrize("basis", [*BASES, "none"])
@pytest.mark.parametrize("bandlimit", [0, 3])
def test_single_triangle(basis, bandlimit):
    mesh = make_mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    transfer = precompute(mesh, bandlimit=bandlimit, samples=16)
    packed = compress(transfer, basis, **({} if basis == "none" else {"terms": 1}))
    if basis in ("adapted", "transport", "slepian", "cpca", "none"):
        assert error(packed, transfer) <= 1e-5  # one normal: one function holds all
    assert np.isfinite(packed.reconstruct()).all()


def test_pilot_is_in_the_vertices_own_frames(shadowed):
    pilot = problem_of(shadowed, 8).pilot
    local = rotate_sh(shadowed.vectors[:, 0], np.swapaxes(rotation_to(shadowed.normals), -1, -2))
    energy = float((local**2).sum(axis=1).mean())
    assert pilot.moments[0].energy == pytest.approx(pilot.energies.sum())
    assert pilot.moments[0].energy == pytest.approx(energy, rel=0.05)


@pytest.mark.parametrize("half_angle", [0.0, 1e-9, 0.3, math.pi])
def test_shared_half_angles_are_a_little_wider(half_angle):
    shared = shared_half_angle(half_angle)
    assert half_angle <= shared * (1 + 1e-8)
    assert shared <= half_angle * 1.0201
    assert shared_half_angle(shared) == pytest.approx(shared, rel=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"terms": 0}, r"terms must be an integer in \[1, 49\], not 0"),
        ({"terms": 50}, r"terms must be an integer in \[1, 49\], not 50"),
        *(({"tolerance": t}, r"^tolerance must be a number in \(0, 1\), not") for t in NO_TOLERANCES),
        ({"tolerance": 0.1, "terms": 4}, "only one of `tolerance`, `terms` and `truncate`"),
        ({"truncate": "n"}, "truncate must be one of n_g, n_ref, count"),
        *(({"truncate": "n_g", "epsilon": e}, r"^epsilon must be a number in \(0, 1\)") for e in (0, 1, 2, math.nan)),
        ({"basis": "fourier"}, "basis must be one of"),
        ({"basis": "none", "terms": 4}, "basis none keeps all functions"),
        ({"clusters": 0}, "clusters must be an integer"),
        ({"coding": "int8"}, "coding must be one of"),
    ],
)
def test_bad_options(options, message, shadowed):
    with pytest.raises(ValueError, match=message):
        compress(shadowed, **options)


def test_what_compress_takes_is_what_settings_have():
    """The same names with the same defaults."""
    given = inspect.signature(compress).parameters
    own = {field.name: field.default for field in dataclasses.fields(CompressionSettings)}
    assert {name: p.default for name, p in given.items() if name not in ("transfer", "report")} == own
    assert not [p for p in given.values() if p.kind is p.VAR_KEYWORD]


@pytest.mark.slow
def test_transport_against_sh_on_nefertiti(data):
    """24 caps, L = 8, K = 4: less than half of SH's error."""
    transfer = precompute(data / "meshes" / "nefertiti.ply", bandlimit=8, samples=1024)
    ours, sh = (error(compress(transfer, b, terms=4, clusters=24), transfer) for b in ("transport", "sh"))
    assert ours < 0.5 * sh


@pytest.mark.slow
def test_adapted_prediction_on_the_skull(data):
    transfer = precompute(data / "meshes" / "skull.ply", bandlimit=10, samples=256)
    for terms in (4, 16, 36, 64):
        packed = compress(transfer, "adapted", terms=terms)
        assert packed.predicted_error == pytest.approx(error(packed, transfer), rel=0.1)


@pytest.mark.slow
def test_a_tolerance_sweep_is_what_each_would_be_alone(shadowed):
    """Shared bases and projections change nothing but rounding of the sums."""
    settings = CompressionSettings(clusters=16)
    sweep = ToleranceSweep(shadowed, settings, group_transfer(settings, shadowed))
    for tolerance in (0.02, 0.05, 0.2, 0.01):  # the last needs more functions than were projected on
        packed, alone = sweep.compress(tolerance), compress(shadowed, tolerance=tolerance, clusters=16)
        assert packed.bytes_per_vertex == pytest.approx(alone.bytes_per_vertex, rel=2e-3)
        assert packed.bases[0].count == alone.bases[0].count
        assert error(packed, shadowed) == pytest.approx(error(alone, shadowed), rel=2e-2)
        assert error(packed, shadowed) <= tolerance * (1.0 + 1e-6)


def test_what_was_coded_is_known_as_it_will_be_decoded(shadowed, tmp_path):
    settings = CompressionSettings(clusters=16)
    packed = ToleranceSweep(shadowed, settings, group_transfer(settings, shadowed)).compress(0.05)
    packed.save(tmp_path / "a.prt", keep_order=True)
    vertices = np.array([700, 3, 3, 1500])
    for wanted in (None, vertices):
        read = load(tmp_path / "a.prt").reconstruct(wanted)
        assert_rounded(read, packed.reconstruct(wanted), terms=2 * 49, size=1.0)  # vectors are shorter than one
    assert_rounded(packed.reconstruct(vertices), packed.reconstruct()[vertices], terms=2 * 49, size=1.0)


def test_starting_from_what_much_the_same_was_coded_with(shadowed):
    settings = CompressionSettings(clusters=16)
    fewer = precompute(bumpy(4), bandlimit=6, samples=64)
    before = compress(shadowed, tolerance=0.05, clusters=16)
    cold = compress(fewer, tolerance=0.05, clusters=16)
    start = WarmStart(before.coded.tuning, coded_along_principal_axes(before))
    warm = ToleranceSweep(fewer, settings, group_transfer(settings, fewer)).compress(0.05, start)
    assert error(warm, fewer) <= 0.05 * (1.0 + 1e-6)
    assert warm.bytes_per_vertex <= 1.05 * cold.bytes_per_vertex
    assert coded_along_principal_axes(warm) == coded_along_principal_axes(before)


def test_one_call_is_what_the_command_does(tmp_path):
    """Settings by name, and what neither transport nor compression has is refused."""
    mesh = bumpy(2)
    packed = sp.precompute_compressed(mesh, bandlimit=4, samples=64, tolerance=0.1, clusters=5)
    same = compress_scene(mesh, CompressionSettings(tolerance=0.1, clusters=5), TransportSettings(4, 64))
    assert_exact(packed.reconstruct(), same.reconstruct(), because="the same calls on the same machine")
    with pytest.raises(UserError, match="'toleranz' is no setting of precompute or compress"):
        sp.precompute_compressed(mesh, toleranz=0.1)
    with pytest.raises(UserError, match="client must be a Dask client, a cluster or the address of a scheduler"):
        sp.precompute_compressed(mesh, client=3)
