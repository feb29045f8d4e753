import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation import hemispherical_transfer as hemispherical_transfer_module
from slepian_prt.evaluation.hemispherical_transfer import hemispherical_transfer
from slepian_prt.evaluation.methods import METHODS, Workload
from slepian_prt.evaluation.metrics import relative_rms
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.hemispherical import hemispherical_sh
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.transfer import Transfer, precompute
from tests.conftest import bumpy
from tests.numerics import assert_exact
from tests.sphere.test_hemispherical import hemisphere_rule

FLOAT16 = 2.0**-11


def transfer_of(vectors: np.ndarray, mesh) -> Transfer:
    bandlimit = math.isqrt(vectors.shape[2]) - 1
    return Transfer(vectors.astype(np.float32), mesh.normals, mesh, (), bandlimit, 1, 0, (), 0, 0)


@pytest.fixture(scope="module")
def ball():
    icosphere = trimesh.creation.icosphere(2)
    return make_mesh(icosphere.vertices, icosphere.faces, normals=icosphere.vertices)


@pytest.fixture(scope="module")
def shadowed():
    traced = precompute(bumpy(4), bandlimit=6, samples=256)
    albedo = np.random.default_rng(4).uniform(0.2, 0.8, traced.mesh.albedo.shape).astype(np.float32)
    return replace(traced, mesh=replace(traced.mesh, albedo=albedo))


def test_unshadowed_transfer_takes_two_functions(ball):
    """(n·ω)₊ is h_00 and h_10, of which the bandlimited part is traced: nothing of it is lost."""
    vectors = (real_sh(10, ball.normals) * cosine_lobe(10)[degrees(10)])[:, None]
    packed = hemispherical_transfer(transfer_of(vectors, ball), 4)
    assert relative_rms(packed.reconstruct(), vectors) < FLOAT16
    others = np.delete(packed.coefficients.astype(float), [0, 2], axis=2)
    assert np.abs(others).max() < 1e-6
    # (1/π) z is (h_00 √(2π)/2 + h_10 √(2π/3)/2) / π
    expected = [math.sqrt(0.5 / math.pi), math.sqrt(1.0 / (6.0 * math.pi))]
    np.testing.assert_allclose(packed.coefficients[:, 0, [0, 2]], np.tile(expected, (len(vectors), 1)), rtol=FLOAT16)


def test_error_falls_to_none_with_all_functions(shadowed):
    errors = [relative_rms(hemispherical_transfer(shadowed, k).reconstruct(), shadowed.vectors) for k in (1, 4, 16, 49)]
    assert errors[0] > errors[1] > errors[2] > errors[3]
    assert errors[3] < FLOAT16


def test_radiance_is_that_of_light_in_each_frame(shadowed, rng):
    """Light of each vertex turned into its frame, integrated against h over the hemisphere, and multiplied."""
    packed = hemispherical_transfer(shadowed, 9)
    light = rng.normal(size=(3, 49))
    found = packed.radiance(light)
    directions, weights = hemisphere_rule(40, 24)
    hemispherical, spherical = hemispherical_sh(2, directions), real_sh(6, directions)
    for vertex in (0, 7, 2000):
        local = rotate_sh(light, rotation_to(shadowed.normals[vertex]).T)
        projected = (spherical @ local.T * weights[:, None]).T @ hemispherical
        expected = projected @ packed.coefficients[vertex, 0].astype(float) * shadowed.mesh.albedo[vertex]
        np.testing.assert_allclose(found[vertex], expected, atol=2e-5 * np.abs(light).sum(axis=1).max())


def test_channels_keep_apart(shadowed, rng):
    coloured = replace(shadowed, vectors=shadowed.vectors * np.float32([1.0, 0.5, 0.25])[:, None])
    gray, packed = hemispherical_transfer(shadowed, 16), hemispherical_transfer(coloured, 16)
    light = rng.normal(size=(3, 49))
    expected = gray.radiance(light) * np.array([1.0, 0.5, 0.25])
    np.testing.assert_allclose(packed.radiance(light), expected, atol=4 * FLOAT16 * np.abs(expected).max())
    assert packed.reconstruct().shape == coloured.vectors.shape


def test_two_bytes_a_function_and_whole_degrees(shadowed):
    assert hemispherical_transfer(shadowed, 16).bytes_per_vertex == 32.0
    odd = hemispherical_transfer(shadowed, 15)
    assert (odd.terms, odd.bytes_per_vertex) == (9, 18.0)


def test_method_keeps_whole_degrees(shadowed):
    """Of 12 functions asked for 9, which is what the run says; a light shows them."""
    told: list[str] = []
    light = np.ones((3, 49))
    work = Workload(shadowed, group_transfer(CompressionSettings(clusters=4), shadowed), [light], (4, 12), told.append)
    runs = list(METHODS["hsh"].run(work))
    assert [(run.terms, run.wanted_terms, run.transfer.bytes_per_vertex) for run in runs] == [(4, 4, 8), (9, 12, 18)]
    assert told == ["hsh, 4 terms", "hsh, 12 terms"]
    assert runs[1].compressed is None
    assert_exact(runs[1].radiance(light), runs[1].transfer.radiance(light), "one passes the other on")


def test_numbers_with_the_same_degrees_are_run_once(shadowed):
    """5 and 8 are 4 functions, 17 and 20 are 16: of each the number nearest to 16, which pictures are drawn of."""
    light = np.ones((3, 49))
    terms = (5, 8, 17, 20, 9)
    work = Workload(shadowed, group_transfer(CompressionSettings(clusters=4), shadowed), [light], terms, lambda _: None)
    assert [(run.wanted_terms, run.terms) for run in METHODS["hsh"].run(work)] == [(8, 4), (17, 16), (9, 9)]


def test_blocks_of_vertices_are_each_in_their_place(shadowed, rng, monkeypatch):
    """Many blocks give what one gives, of coefficients, vectors and radiance; the last is not full."""
    whole, light = hemispherical_transfer(shadowed, 16), rng.normal(size=(3, 49))
    expected = [whole.coefficients.astype(float), whole.reconstruct(), whole.radiance(light)]
    monkeypatch.setattr(hemispherical_transfer_module, "_BLOCK", 100)
    assert len(shadowed.vectors) % 100 > 0
    blocks = hemispherical_transfer(shadowed, 16)
    found = [blocks.coefficients.astype(float), blocks.reconstruct(), blocks.radiance(light)]
    for one, many in zip(expected, found, strict=True):
        # Products of other shapes are rounded otherwise, which may move a float16 by its last place.
        np.testing.assert_allclose(many, one, rtol=0.0, atol=2.0 * FLOAT16 * np.abs(one).max())


def test_vertices_without_a_normal_stay_dark(ball):
    vectors = real_sh(4, ball.normals)[:, None]
    vectors[3] = 0.0
    normals = ball.normals.copy()
    normals[3] = 0.0
    packed = hemispherical_transfer(transfer_of(vectors, replace(ball, normals=normals)), 4)
    assert not packed.radiance(np.ones((3, 25)))[3].any()
    assert np.isfinite(packed.reconstruct()).all()
