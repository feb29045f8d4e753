"""Light in pages: the JavaScript of the viewer against the package's Python, in the browser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.lighting.windowing import WINDOWS, window, windowed
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.relight import negative_fraction
from slepian_prt.runtime.gpu_transfer import gpu_transfer
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.transfer import Transfer, precompute
from tests.conftest import bumpy, random_directions
from tests.numerics import assert_exact, assert_rounded

BANDLIMITS = (3, 10, 20)

ROTATE = 'const { rotateSh } = await import("#harmonics"); return rotateSh(c, bandlimit, r);'
PROJECT = """
const { projectTexels } = await import("#projection");
return projectTexels({ height, width, data }, bandlimit, r);
"""


def some_rotation(rng: np.random.Generator) -> np.ndarray:
    first, second = rotation_to(random_directions(rng, 2))
    return first @ second.T


# --- Rotation and windows --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bandlimit", BANDLIMITS)
def test_rotation(bandlimit, modules, rng):
    coefficients = rng.normal(size=(3, num_coefficients(bandlimit)))
    identity, half_turn = np.eye(3), np.diag([1.0, -1.0, -1.0])  # where an angle of Euler's is not determined
    tilted = rotation_to([1e-9, 0.0, 1.0]) @ rotation_to([1.0, 0.0, 0.0])
    for rotation in (some_rotation(rng), identity, half_turn, tilted):
        found = modules.run(ROTATE, c=coefficients, bandlimit=bandlimit, r=rotation)
        # Two products with orthogonal matrices whose entries are good to as many roundings, and three turns.
        terms = 4 * (2 * bandlimit + 1) + 6
        size = max(np.linalg.norm(coefficients[:, degrees(bandlimit) == l], axis=1).max() for l in range(bandlimit + 1))
        assert_rounded(found.reshape(3, -1), rotate_sh(coefficients, rotation), terms, size)


@pytest.mark.parametrize(
    ("rotation", "message"),
    [
        (1.1 * np.eye(3), "must be a proper rotation matrix (R Rᵀ differs from 1 by 0.210)"),
        (-np.eye(3), "must be a proper rotation matrix"),
        (np.full((3, 3), np.nan), "must be a proper rotation matrix"),
    ],
)
def test_what_is_no_rotation(rotation, message, modules):
    assert message in modules.error(ROTATE, c=np.ones(4), bandlimit=1, r=rotation)
    assert "a multiple of 4" in modules.error(ROTATE, c=np.ones(5), bandlimit=1, r=np.eye(3))


@pytest.mark.parametrize("name", WINDOWS)
def test_windows(name, modules, rng):
    coefficients = rng.normal(size=(3, 121))
    body = """
    const { damped, degreesOf, windowFactors } = await import("#harmonics");
    const factors = windowFactors(name, 10, width);
    return [factors, damped(c, factors), degreesOf(10)];
    """
    for width in (0.5, 1.0, 7.5, 11.0, 160.0):
        factors, damped, found = modules.run(body, name=name, width=width, c=coefficients)
        assert_rounded(factors, window(name, 10, width), terms=4, size=1.0)
        assert_rounded(damped, windowed(coefficients, name, width).ravel(), terms=5)
        assert_exact(found, degrees(10), because="integers")
    assert "larger than 0 degrees" in modules.error(body, name=name, width=0.0, c=coefficients)


# --- Projection ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bandlimit", BANDLIMITS)
@pytest.mark.parametrize("height", [3, 20, 64, 180])  # fewer than 8 rows per degree are interpolated first
def test_projection(bandlimit, height, modules, rng):
    texels = rng.exponential(size=(height, 2 * height, 3)).astype(np.float32)
    rotation = some_rotation(rng)
    found = modules.run(PROJECT, height=height, width=2 * height, data=texels, bandlimit=bandlimit, r=rotation)
    assert_projected(found, texels, bandlimit, rotation)


def test_projection_of_a_map_of_another_shape(modules, rng):
    texels = rng.exponential(size=(30, 50, 3)).astype(np.float32)
    found = modules.run(PROJECT, height=30, width=50, data=texels, bandlimit=5, r=np.eye(3))
    assert_projected(found, texels, 5, np.eye(3))


def assert_projected(found: np.ndarray, texels: np.ndarray, bandlimit: int, rotation: np.ndarray) -> None:
    height, width = texels.shape[:2]
    expected = TexelProjection(height, width, bandlimit, rotation)(texels)
    rows = max(height, 16 * (bandlimit + 1))  # that are projected, at most; twice as many columns
    terms = 3 * rows + 2 * (2 * bandlimit + 1)
    largest_harmonic = np.sqrt((2 * bandlimit + 1) / (2 * np.pi))
    assert_rounded(found.reshape(3, -1), expected, terms, size=4 * np.pi * float(texels.max()) * largest_harmonic)


def test_the_page_answers_meanwhile(modules):
    ticks = modules.run("""
    const { projectTexels } = await import("#projection");
    let ticks = 0;
    const timer = setInterval(() => { ticks++; }, 1);
    await projectTexels({ height: 1024, width: 2048, data: new Float32Array(3 * 2 ** 21).fill(1) }, 20);
    clearInterval(timer);
    return ticks;
    """)
    assert ticks >= 2


# --- Functions of caps, and radiance ---------------------------------------------------------------------------------


def random_model(rng: np.random.Generator, channels: int, vertices: int = 500) -> dict:
    """A file for shaders of 5 caps of 8 functions, L = 3."""
    return {
        "functions": 8,
        "caps": 5,
        "channels": channels,
        "table": rng.normal(size=(5, 8, channels, 16)).astype(np.float32),
        "zeros": rng.random((5, 7)).astype(np.float32),
        "bytes": np.column_stack([rng.integers(0, 256, (vertices, 7)), rng.integers(0, 5, vertices)]).astype(np.uint8),
    }


def decode(model: dict, used: int) -> np.ndarray:
    """(V, channels, M) transfer, by the definition: t(v) = f_0 + Σ (q_k/255 - z_k) f_k of its cap."""
    caps = model["bytes"][:, -1]
    weights = model["bytes"][:, :-1] / 255.0 - model["zeros"][caps]
    weights[:, used - 1 :] = 0.0
    table = model["table"].astype(np.float64)[caps]
    return table[:, 0] + np.einsum("vk,vkcm->vcm", weights, table[:, 1:])


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("used", [1, 5, 8])
def test_radiance_of_vertices(channels, used, modules, rng):
    model, light = random_model(rng, channels), rng.normal(size=(3, 16))
    body = """
    const { lightFunctions } = await import("#light");
    const { radianceOfVertices } = await import("#radiance");
    const lit = lightFunctions(model, light, used);
    return [lit, radianceOfVertices(model, lit), radianceOfVertices(model, lit, 100, 103)];
    """
    lit, radiance, some = modules.run(body, model=model, light=light, used=used)
    transfer = np.broadcast_to(decode(model, used), (500, 3, 16))
    lit = lit.reshape(5, 8, 4)
    assert not lit[:, used:].any()
    assert not lit[..., 3].any()
    # Sums in float64 of lit functions in float32, each rounded once.
    size = float(np.abs(lit).sum(axis=1).max())
    expected = np.einsum("vcm,cm->vc", transfer, light).astype(np.float32)
    assert_rounded(radiance.reshape(-1, 3), expected, terms=2, size=size)
    assert_exact(some, radiance[300:309], because="the same vertices")


@pytest.fixture(scope="module")
def ringing() -> tuple[Transfer, np.ndarray]:
    """Transfer of a ball with a sun, and reflectance, whose light rings."""
    texels = np.full((256, 512, 3), 0.001)
    texels[60:64, 100:104] = 500.0
    transfer = precompute(bumpy(3), bandlimit=3, samples=256)
    reflectance = np.random.default_rng(3).integers(20000, 65536, (len(transfer.vectors), 3)).astype(np.uint16)
    mesh = replace(transfer.mesh, albedo=(reflectance / 65535.0).astype(np.float32))
    return replace(transfer, mesh=mesh), project_environment(texels, 3)


def one_cap(vectors: np.ndarray) -> dict:
    """Vectors (V, 1, M) as a cap with their mean and as many principal components as they have."""
    flat = vectors[:, 0].astype(np.float64)
    mean = flat.mean(axis=0)
    functions = np.linalg.svd(flat - mean, full_matrices=False)[2][:15]
    along = (flat - mean) @ functions.T
    low, span = along.min(axis=0), np.ptp(along, axis=0)
    coded = np.rint((along - low) / span * 255.0).astype(np.uint8)
    return {
        "functions": 16,
        "caps": 1,
        "channels": 1,
        "table": np.concatenate([mean[None], span[:, None] * functions]).astype(np.float32),
        "zeros": (-low / span).astype(np.float32)[None],
        "bytes": np.column_stack([coded, np.zeros(len(coded), np.uint8)]),
    }


@pytest.mark.parametrize("name", WINDOWS)
def test_the_width_of_a_window(name, ringing, modules):
    transfer, light = ringing
    model = one_cap(transfer.vectors)
    decoded = replace(transfer, vectors=decode(model | {"table": model["table"].reshape(1, 16, 1, 16)}, 16))
    expected = damp(replace(decoded, vectors=decoded.vectors.astype(np.float32)), light, name)
    assert expected.negative_before > 0.01
    reflectance = np.rint(transfer.mesh.albedo * 65535.0).astype(np.uint16)
    body = 'const { dampLight } = await import("#radiance"); return dampLight(model, light, name, { reflectance });'
    found = modules.run(body, model=model, light=light, name=name, reflectance=reflectance)
    # A vertex at the bound may round to either side of it: the width is searched to 1 %.
    np.testing.assert_allclose(found["width"], expected.width, rtol=0.01)
    assert abs(found["before"] - expected.negative_before) <= 1.0 / len(reflectance)
    assert found["after"] <= 1e-3
    assert_rounded(found["coefficients"].reshape(3, -1), windowed(light, name, found["width"]), terms=5)


def test_light_without_ringing_is_left_alone(ringing, modules):
    transfer, _ = ringing
    light = project_environment(np.ones((64, 128, 3)), 3)
    body = 'const { dampLight } = await import("#radiance"); return dampLight(model, light, "hann");'
    found = modules.run(body, model=one_cap(transfer.vectors), light=light)
    assert_exact(found["coefficients"], light.ravel(), because="a copy")
    assert (found["width"], found["before"]) == (np.inf, 0.0)


def test_receivers_that_are_drawn_several_times_count_once(modules, rng):
    model, light = random_model(rng, 1, vertices=300), rng.normal(size=(3, 16))
    receivers = rng.integers(0, 200, 300).astype(np.uint32)
    model["bytes"] = model["bytes"][receivers]  # of the same receiver the same bytes
    body = """
    const { lightFunctions } = await import("#light");
    const { countedVertices, negativeFraction } = await import("#radiance");
    const counted = countedVertices(receivers), lit = lightFunctions(model, light);
    return [counted, await negativeFraction(model, lit, { counted }), await negativeFraction(model, lit)];
    """
    counted, once, all_drawn = modules.run(body, model=model, light=light, receivers=receivers)
    assert sorted(receivers[counted]) == np.unique(receivers).tolist()
    radiance = np.einsum("vcm,cm->vc", np.broadcast_to(decode(model, 8), (300, 3, 16)), light)
    assert once == negative_fraction(radiance[counted])
    assert all_drawn == negative_fraction(radiance)
    assert once != all_drawn


def test_negative_vertices_of_a_large_model(modules, rng):
    model, light = random_model(rng, 3, vertices=10_000), rng.normal(size=(3, 16))
    reflectance = rng.integers(0, 65536, (10_000, 3)).astype(np.uint16)
    body = """
    const { lightFunctions } = await import("#light"), { negativeFraction } = await import("#radiance");
    return negativeFraction(model, lightFunctions(model, light), { reflectance });
    """
    found = modules.run(body, model=model, light=light, reflectance=reflectance)
    radiance = np.einsum("vcm,cm->vc", decode(model, 8), light) * (reflectance / 65535.0)
    assert abs(found - negative_fraction(radiance)) <= 1.5 / 10_000  # one may round to either side of the bound


def test_a_file_for_shaders_is_lit_as_python_lights_it(ringing, modules):
    transfer, light = ringing
    packed = gpu_transfer(compress(transfer, tolerance=0.05, clusters=8), functions=16)
    body = """
    const { lightFunctions } = await import("#light"), { radianceOfVertices } = await import("#radiance");
    const lit = lightFunctions(model, light);
    return [lit, radianceOfVertices(model, lit)];
    """
    model = {
        "functions": packed.function_count,
        "caps": packed.cap_count,
        "channels": packed.channels,
        "table": packed.functions,
        "zeros": packed.zeros,
        "bytes": packed.vertices,
    }
    lit, radiance = modules.run(body, model=model, light=light)
    table = lit.reshape(packed.cap_count, packed.function_count, 4)[..., :3]
    # Python adds up in float32: the products of a function and a light, those of the zeros, and those of the bytes.
    size = float(np.abs(light).sum(axis=1).max() * np.abs(packed.functions).max())
    assert_rounded(table, packed.light(light), terms=16 + 16, size=size)
    largest = float(np.abs(table).sum(axis=1).max())
    assert_rounded(radiance.reshape(-1, 3), packed.relight(light), terms=16 + 32, size=max(size, largest))
