"""Several threads relight at once, as in a web service."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

import slepian_prt as sp
from slepian_prt.relighting import operator
from tests.numerics import assert_exact

THREADS = 8


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    from slepian_prt.examples import example

    path = tmp_path_factory.mktemp("threads") / "knot.prt"
    transfer = sp.precompute(example("cornell"), 4, 16, effects="direct")
    sp.compress(transfer, clusters=12, tolerance=0.05).save(path)
    return path


def together(work):
    """Results of ``work(i)`` of eight threads that begin at once."""
    barrier = Barrier(THREADS)

    def begin(i: int):
        barrier.wait()
        return work(i)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(begin, range(THREADS)))


def test_a_loaded_file_is_decoded_once_and_relit_with_the_same_bits(file, rng, monkeypatch):
    made = []
    of_caps = operator.all_factors
    monkeypatch.setattr(operator, "all_factors", lambda packed: made.append(packed) or of_caps(packed))
    lights = rng.normal(size=(THREADS, 3, 25))
    shared = sp.load(file)
    meshes = together(lambda _: shared.mesh)
    assert all(mesh is meshes[0] for mesh in meshes)
    found = together(lambda i: sp.relight(shared, lights[i]))
    assert len(made) == 1
    alone = sp.load(file)
    for light, radiance in zip(lights, found, strict=True):
        assert_exact(radiance, sp.relight(alone, light), because="one thread of BLAS multiplies, whoever else does")


def test_maps_are_projected_to_the_same_bits(rng):
    maps = rng.random((THREADS, 64, 128, 3))
    found = together(lambda i: sp.project_environment(maps[i], 6))
    for texels, lighting in zip(maps, found, strict=True):
        assert_exact(lighting, sp.project_environment(texels, 6), because="the same sums in the same order")
