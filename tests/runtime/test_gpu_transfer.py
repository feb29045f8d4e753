from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.spectrum import falling_prior, light_power
from slepian_prt.relighting.relight import relight
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, random_directions
from tests.numerics import assert_exact, assert_rounded
from tests.runtime_reference import lit_table, relit, transfer_vectors

BANDLIMIT = 6


@pytest.fixture(scope="module")
def traced():
    return precompute(bumpy(4), bandlimit=BANDLIMIT, samples=256)


@pytest.fixture(scope="module")
def packed(traced):
    return compress(traced, tolerance=0.03)


@pytest.fixture(scope="module")
def coloured():
    """Light that comes back coloured from a floor: three channels."""
    ball = bumpy(3)
    floor = np.array([[-4.0, -1.4, -4.0], [-4.0, -1.4, 4.0], [4.0, -1.4, 4.0], [4.0, -1.4, -4.0]])
    faces = np.concatenate([ball.faces, [[0, 1, 2], [0, 2, 3]] + np.array(len(ball.positions))])
    albedo = np.concatenate([np.full((len(ball.positions), 3), 0.7), np.tile([0.9, 0.2, 0.1], (4, 1))])
    mesh = make_mesh(np.concatenate([ball.positions, floor]), faces, albedo=albedo, name="ball on a floor")
    transfer = precompute(mesh, bandlimit=BANDLIMIT, samples=256)
    assert transfer.vectors.shape[1] == 3
    return compress(transfer, tolerance=0.03)


@pytest.fixture
def falling(rng):
    """Light whose power falls as 1/(l+1)²."""
    size = num_coefficients(BANDLIMIT)
    return rng.normal(size=(3, size)) * falling_prior(BANDLIMIT).weights[degrees(BANDLIMIT)]


def vectors_of(packed):
    return packed.reconstruct()


@pytest.mark.parametrize("functions", [8, 16, 24, 32])
def test_error_is_what_the_reference_measures(packed, coloured, functions):
    """Degree by degree, of what 30 lines that know only the format decode."""
    for one in (packed, coloured):
        gpu = gpu_transfer(one, functions)
        wanted = vectors_of(one)
        difference = transfer_vectors(gpu.vertices, gpu.functions, gpu.zeros) - wanted
        degree = degrees(BANDLIMIT)
        lost = np.bincount(degree, np.sum(difference.astype(float) ** 2, axis=(0, 1)))
        # Functions that hold less than a hundredth of the file's error are left out before (1e-2 of its norm, at most).
        left_out = 0.01 * one.predicted_error * np.sqrt(np.sum(wanted**2))
        np.testing.assert_allclose(
            np.sqrt(gpu.expected.lost), np.sqrt(lost), rtol=1e-3, atol=left_out + 1e-5 * np.sqrt(np.sum(wanted**2))
        )
        np.testing.assert_allclose(
            np.sqrt(gpu.expected.total.sum()), np.sqrt(np.sum(wanted.astype(float) ** 2)), rtol=1e-3
        )


def test_more_functions_lose_less(packed):
    errors = [gpu_transfer(packed, count).error() for count in (8, 16, 24, 32)]
    assert all(np.diff(errors) < 0.0)
    assert errors[1] < 0.02


@pytest.mark.parametrize("channels", [1, 3])
def test_radiance_is_that_of_the_vectors(packed, coloured, channels, falling):
    one = packed if channels == 1 else coloured
    gpu = gpu_transfer(one)
    assert gpu.channels == channels
    exact = np.einsum(
        "vcm,cm->vc", np.broadcast_to(transfer_vectors(gpu.vertices, gpu.functions, gpu.zeros),
                                      (one.vertex_count, 3, falling.shape[1])), falling
    )  # fmt: skip
    np.testing.assert_allclose(relit(gpu.vertices, lit_table(gpu.functions, gpu.zeros, falling)), exact, atol=1e-12)
    # K products of float32, of sums of M products.
    size = float(np.abs(gpu.functions).sum(axis=(1, 3)).max() * np.abs(falling).max())
    assert_rounded(gpu.relight(falling), exact.astype(np.float32), gpu.function_count + falling.shape[1], size)


def test_radiance_is_near_that_of_the_file(coloured, falling, rng):
    """Averaged over rotations, by as much as it says."""
    gpu = gpu_transfer(coloured)
    albedo = coloured.mesh.receivers.albedo
    squares, total = 0.0, 0.0
    for direction in random_directions(rng, 20):
        turn = np.linalg.qr(np.stack([direction, *rng.normal(size=(2, 3))]).T)[0]
        light = rotate_sh(falling, turn * np.linalg.det(turn))
        wanted = relight(coloured, light)
        squares += np.sum((gpu.relight(light) * albedo - wanted) ** 2)
        total += np.sum(wanted**2)
    # 20 rotations of three colours leave the mean uncertain by a fifth or so; albedo weighs receivers anew.
    assert np.sqrt(squares / total) == pytest.approx(gpu.error(falling), rel=0.35)


def test_fewer_functions_go_back_to_the_mean(packed, falling):
    """What is left out counts as zero, which is where the mean is: errors grow, but nothing drifts."""
    gpu, wanted = gpu_transfer(packed), relight(packed, falling)
    errors = [
        np.linalg.norm(relit(gpu.vertices, lit_table(gpu.functions, gpu.zeros, falling, used)) - wanted)
        / np.linalg.norm(wanted)
        for used in (1, 2, 4, 8, 16)
    ]
    assert all(np.diff(errors) < 0.0)
    means = lit_table(gpu.functions, gpu.zeros, falling, 1)[gpu.vertices[:, -1], 0]
    for c in range(gpu.cap_count):
        own = gpu.vertices[:, -1] == c
        if own.any():  # half a step of each byte's range, with what functions there are
            slack = 0.5 / 255.0 * np.abs(lit_table(gpu.functions, gpu.zeros, falling)[c, 1:]).sum(axis=0).max()
            mean = gpu.relight(falling)[own].mean(axis=0)
            np.testing.assert_allclose(means[own][0], mean, atol=slack + 1e-5)


def test_no_seam_beyond_that_of_the_file(traced, packed, falling):
    """Across edges between caps, radiance jumps less wrongly than in the file itself."""
    gpu = gpu_transfer(packed)
    faces = packed.mesh.faces
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    crossing = edges[gpu.vertices[edges[:, 0], -1] != gpu.vertices[edges[:, 1], -1]]
    assert len(crossing) > 500
    full, file, ours = relight(traced, falling), relight(packed, falling), gpu.relight(falling)

    def jump(radiance, among):
        return np.sqrt(np.mean((radiance[among[:, 0]] - radiance[among[:, 1]]) ** 2))

    assert jump(ours - file, crossing) < jump(file - full, crossing)


def test_coefficients_use_their_bytes(packed):
    gpu = gpu_transfer(packed)
    for c in range(gpu.cap_count):
        own = gpu.vertices[gpu.vertices[:, -1] == c, :-1]
        used = np.any(gpu.functions[c, 1:] != 0.0, axis=(1, 2))
        assert_exact(own.min(axis=0)[used], 0, "the smallest coefficient of each component")
        assert_exact(own.max(axis=0)[used], 255, "the largest")
    energies = np.mean((gpu.vertices[:, :-1] / 255.0 - gpu.zeros[gpu.vertices[:, -1]]) ** 2 * np.sum(
        (gpu.functions[:, 1:] * falling_prior(BANDLIMIT).weights[degrees(BANDLIMIT)]) ** 2, axis=(2, 3)
    )[gpu.vertices[:, -1]], axis=0)  # fmt: skip
    assert np.all(np.diff(energies) <= 1e-3 * energies[0])  # those that carry most come first


def test_fewer_bits_lose_more(packed):
    fine, coarse = gpu_transfer(packed, 16, bits=8), gpu_transfer(packed, 16, bits=4)
    assert len(np.unique(coarse.vertices[:, :-1])) <= 16
    assert fine.error() < coarse.error()
    # A 15th of the range of a component is rounded by up to half of that, uniformly.
    assert coarse.error() < 0.1


def test_functions_are_numbers_of_float16(packed, coloured):
    for one in (packed, coloured):
        functions = gpu_transfer(one).functions
        assert_exact(functions.astype(np.float16).astype(np.float32), functions, "rounded to float16")


def test_vertices_of_no_face_stay_dark(falling):
    ball = bumpy(3)
    mesh = make_mesh(np.concatenate([ball.positions, [[3.0, 0.0, 0.0]]]), ball.faces, name="a vertex too many")
    packed = compress(precompute(mesh, bandlimit=BANDLIMIT, samples=64), tolerance=0.05)
    active = packed.mesh.receivers.active
    assert not active.all()
    gpu = gpu_transfer(packed)
    assert_exact(gpu.relight(falling)[~active], 0.0, "functions that are all zero")
    assert np.all(np.abs(gpu.relight(falling)[active]).max(axis=1) > 0.0)
    assert_exact(gpu.vertices[~active, -1], gpu.cap_count - 1, "the dark cap comes last")


def test_more_caps_than_a_byte_counts(traced, falling):
    packed = compress(traced, tolerance=0.03, clusters=400)
    gpu = gpu_transfer(packed)
    assert gpu.cap_count <= 255
    wanted = vectors_of(packed)
    difference = transfer_vectors(gpu.vertices, gpu.functions, gpu.zeros) - wanted
    weights = falling_prior(BANDLIMIT).weights[degrees(BANDLIMIT)]
    measured = np.linalg.norm(difference * weights) / np.linalg.norm(wanted * weights)
    # Functions that hold less than a hundredth of the file's error are left out before, and not counted here.
    assert 0.98 * gpu.error() < measured < 1.02 * np.hypot(gpu.error(), 0.01 * packed.predicted_error)
    assert measured < 0.05


def test_vectors_in_memory(traced):
    """Full SH goes the same way, with nothing lost but here."""
    gpu = gpu_transfer(traced, 32)
    assert gpu.of_file.relative() < 1e-5
    assert gpu.relit_error() == pytest.approx(gpu.error(), rel=1e-3)
    wanted = traced.vectors.reshape(len(traced.vectors), 1, -1)
    difference = transfer_vectors(gpu.vertices, gpu.functions, gpu.zeros) - wanted
    assert np.linalg.norm(difference) / np.linalg.norm(wanted) == pytest.approx(gpu.expected.relative(), rel=0.01)


@pytest.mark.parametrize("size", [1e-2, 0.0])
def test_dim_transfer_loses_no_larger_part(traced, size):
    """As that of dark colours in three channels: what is rounded goes by its size."""
    dim = gpu_transfer(replace(traced, vectors=(size * traced.vectors).astype(np.float32)))
    if size == 0.0:
        assert_exact(dim.functions, 0.0, "nothing is there")
    else:
        assert dim.error() == pytest.approx(gpu_transfer(traced).error(), rel=0.05)


def test_as_many_functions_as_there_are_lose_only_rounding(traced):
    gpu = gpu_transfer(compress(traced, "none", coding="float32", clusters=1), 56, caps=1)  # 49 and more
    # Half a 255th of ranges of some six standard deviations, in each coefficient.
    assert gpu.error() < 0.006


def test_few_receivers():
    mesh = make_mesh([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2]], name="triangle")
    packed = compress(precompute(mesh, bandlimit=3, samples=64), tolerance=0.05)
    gpu = gpu_transfer(packed)
    difference = transfer_vectors(gpu.vertices, gpu.functions, gpu.zeros) - vectors_of(packed)
    np.testing.assert_allclose(difference, 0.0, atol=0.01)


def test_vectors_are_not_formed(packed, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("transfer vectors were formed")

    monkeypatch.setattr("slepian_prt.compression.decoder.reconstruct", refuse)
    monkeypatch.setattr("slepian_prt.compression.linear_basis.LinearBasis.reconstruct", refuse)
    gpu_transfer(packed)


def test_combined_error(packed, falling):
    gpu = gpu_transfer(packed)
    power = light_power(falling)
    assert gpu.relit_error(falling) == pytest.approx(np.hypot(gpu.error(falling), packed.expected.relative(power)))
    assert f"{gpu.error():.4g}" in repr(gpu)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"functions": 12}, "functions must be a multiple of 8 from 8 to 128, not 12"),
        ({"functions": 0}, "functions must be an integer in"),
        ({"functions": 16, "bits": 9}, "bits must be an integer in"),
        ({"functions": 16, "caps": 256}, "caps must be an integer in"),
    ],
)
def test_wrong_numbers(packed, arguments, message):
    with pytest.raises(UserError, match=message):
        gpu_transfer(packed, **arguments)


def test_light_of_another_bandlimit_is_cut_or_filled_up(packed, rng):
    gpu, size = gpu_transfer(packed), (packed.bandlimit + 1) ** 2
    longer = rng.normal(size=(3, (packed.bandlimit + 3) ** 2))
    filled = np.where(np.arange(size) < 4, longer[:, :size], 0.0)
    assert_exact(gpu.relight(longer), gpu.relight(longer[:, :size]), "the same numbers")
    assert_exact(gpu.relight(longer[:, :4]), gpu.relight(filled), "the same numbers")
    for wrong in ((3, 5), (2, 3, 4), (4,)):
        with pytest.raises(UserError, match=r"lighting must have shape \(3, n²\)"):
            gpu.relight(np.zeros(wrong))


def test_errors_are_told_under_light_of_another_bandlimit(packed, rng):
    gpu, size = gpu_transfer(packed), (packed.bandlimit + 1) ** 2
    longer = rng.normal(size=(3, (packed.bandlimit + 3) ** 2))
    filled = np.where(np.arange(size) < 4, longer[:, :size], 0.0)
    for tell in (gpu.error, gpu.relit_error, packed.predicted_relit_error):
        assert tell(longer) == tell(longer[:, :size])
        assert tell(longer[:, :4]) == tell(filled)
