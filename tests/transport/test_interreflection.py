"""Light between surfaces against closed forms and Mitsuba's path tracer."""

import math
import tracemalloc

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.stats import t as student_t

from slepian_prt.evaluation.reference import vertex_reference
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.transport.interreflection import Gather, add_bounces
from slepian_prt.transport.transfer import Transfer, precompute
from tests.conftest import ROOT, inside_out, sphere
from tests.numerics import assert_rounded

AMBIENT = math.sqrt(4 * math.pi)


def spherical_bowl(part: float, rings: int = 48) -> Mesh:
    """The inside of the lower ``part`` of the unit sphere's area, with an exact rim."""
    spokes = 2 * rings
    theta = np.linspace(0.0, math.acos(1.0 - 2.0 * part), rings + 1)[1:]
    phi = 2.0 * np.pi * np.arange(spokes) / spokes
    ring = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            -np.outer(np.cos(theta), 1 + 0 * phi),
        ],
        axis=-1,
    )
    positions = np.concatenate([[[0.0, 0.0, -1.0]], ring.reshape(-1, 3)])
    k, following = np.arange(spokes), (np.arange(spokes) + 1) % spokes
    faces = [np.column_stack([0 * k, 1 + k, 1 + following])]
    for i in range(rings - 1):
        a, b = 1 + i * spokes + k, 1 + i * spokes + following
        faces += [np.column_stack([a, a + spokes, b]), np.column_stack([b, a + spokes, b + spokes])]
    return make_mesh(positions, np.concatenate(faces), normals=-positions)


def ambient(transfer: Transfer) -> np.ndarray:
    return transfer.vectors[:, 0, 0].astype(np.float64) * AMBIENT


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [0.5, 0.95])
@pytest.mark.parametrize("part", [0.5, 0.9])
def test_bowl_has_a_closed_form(part, albedo):
    """Every point of a sphere's inside receives equally from every other: bounce b is ρ^(b+1) (1-f) f^b everywhere."""
    bowl = spherical_bowl(part)
    direct = ambient(precompute(bowl, 0, 1024, albedo=albedo, bounces=0)) * albedo
    once = ambient(precompute(bowl, 0, 1024, albedo=albedo, bounces=1)) * albedo - direct
    transfer = precompute(bowl, 0, 1024, albedo=albedo)
    total = ambient(transfer) * albedo
    # Facets of 3 degrees put chords for arcs: areas, and with them f, are off by less than (3°)²/8 = 0.04 %, which
    # (1 - f) magnifies to 0.3 % at f = 0.9; sampling is far below that in the mean.
    assert direct.mean() == pytest.approx(albedo * (1 - part), rel=4e-3)
    assert once.mean() == pytest.approx(albedo**2 * (1 - part) * part, rel=4e-3)
    assert total.mean() == pytest.approx(albedo * (1 - part) / (1 - albedo * part), rel=4e-3)
    # 900 nodes find the rim, a smooth curve, to better than 2 % of the open part at each vertex, and the many surfaces
    # that a vertex gathers from average that.
    assert np.abs(direct / direct.mean() - 1).max() < 0.04
    assert np.abs(total / total.mean() - 1).max() < 0.02
    # The rest of the series is below a thousandth.
    assert (albedo * part) ** (transfer.bounces + 1) < 2e-3


def test_rooms():
    room = inside_out(sphere(3))
    white, black = (precompute(room, 2, 256, albedo=a, effects="auto") for a in (1.0, 0.0))
    assert not white.vectors.any()  # closed: no light comes in, whatever the walls reflect
    assert not black.vectors.any()
    verdicts = {effect.name: effect.verdict for effect in black.effects}
    assert verdicts["interreflection"] == "omitted"
    assert white.bounces == 0


@pytest.fixture(scope="module")
def cornell():
    return precompute(ROOT / "scenes" / "cornell.xml", 1, 1024)


@pytest.mark.slow
def test_colour_bleeds(cornell):
    """Next to the red wall the floor is redder than next to the green one, and the reverse."""
    assert cornell.vectors.shape[1] == 3
    floor = next(part for part in cornell.parts if part.name == "floor")
    own = slice(floor.first, floor.first + floor.count)
    light = cornell.vectors[own, :, 0]
    x = cornell.positions[own, 0]
    left, right = light[x < -0.9].mean(axis=0), light[x > 0.9].mean(axis=0)
    assert left[0] > 1.1 * left[1]
    assert right[1] > 1.1 * right[0]


@pytest.mark.slow
def test_cornell_box_agrees_with_the_path_tracer(cornell):
    """Per vertex, under a light that the bandlimit holds exactly: differences are noise, by a Z-test."""
    light = make_environment(np.full((8, 16, 3), 1.0, dtype=np.float32) * [1.0, 0.8, 0.6])
    relit = relight(cornell, project_environment(light, 1))
    with open_scene(ROOT / "scenes" / "cornell.xml") as scene:
        runs = [vertex_reference(scene, light, noise=1.0, bounces=cornell.bounces, seed=seed) for seed in range(8)]
    radiance = np.stack([run.radiance for run in runs]).astype(np.float64)
    mean, deviation = radiance.mean(axis=0), radiance.std(axis=0, ddof=1) / math.sqrt(len(runs))
    # Vertices well inside the block are black in both.
    lit = mean.max(axis=1) > 0.02
    # Beside the reference's noise there is that of our own directions, measured by turning them otherwise.
    other = relight(precompute(ROOT / "scenes" / "cornell.xml", 1, 1024, seed=1), project_environment(light, 1))
    own = np.sqrt(np.mean(((relit - other)[lit] / mean[lit]) ** 2) / 2) * mean[lit]
    assert own.mean() < 0.02 * mean[lit].mean()
    difference, noise = relit[lit] - mean[lit], np.sqrt(deviation[lit] ** 2 + own**2)
    z = difference / noise
    assert abs(z.mean()) < 0.15
    # The deviation is estimated from eight runs: Student's t with 7 degrees of freedom, 2.0 % beyond 3. Of some 20,000
    # vertices, with channels that go together, three standard errors are 0.3 %.
    assert np.mean(np.abs(z) > 3.0) == pytest.approx(2.0 * student_t.sf(3.0, len(runs) - 1), abs=0.003)
    assert np.sqrt(np.mean(difference**2)) < 1.2 * np.sqrt(np.mean(noise**2))


def test_bounces_hold_a_few_columns_at_a_time(monkeypatch, rng):
    """Beside transfer itself: what is bounced, what it becomes and their sum, of 16 columns, by each thread."""
    monkeypatch.setenv("SLEPIAN_PRT_THREADS", "1")
    bowl = spherical_bowl(0.7, 24)
    count, size, seen = len(bowl.positions), 441, 20
    places = (rng.random((count, seen)) * count).astype(np.int32)
    weights = csr_array((np.full(count * seen, 0.7 / seen, np.float32), places.ravel(), seen * np.arange(count + 1)),
                        shape=(count, count))  # fmt: skip
    gather = Gather(np.arange(count), weights, 0.0, 0.0, 0)
    direct = rng.random((count, size), dtype=np.float32)
    light, expected = direct.copy(), direct.astype(np.float64)
    for _ in range(5):
        light = weights @ (np.float32(0.7) * light)
        expected += light
    tracemalloc.start()
    try:
        total = add_bounces(gather, bowl.albedo * 0.7, direct, 1, 5)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # Each bounce adds 20 numbers of float32, five bounces follow each other; the series is at most 1 / (1 - 0.49).
    assert_rounded(total[:, 0], expected.astype(np.float32), terms=5 * 21, size=2.0)
    assert peak < 6 * 16 * 4 * count + 1.2e5
    assert peak < 0.3 * direct.nbytes
