"""Products with sparse matrices by Dr.Jit, against SciPy's."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.transport.device.sparse import DeviceSparse
from slepian_prt.transport.interreflection import Gather
from tests.numerics import assert_exact, assert_rounded


def matrix_of(rows, columns, rng):
    """With rows of no entry, and of all."""
    dense = random_array((rows, columns), density=0.1, rng=rng, dtype=np.float32).toarray()
    dense[0], dense[-1] = 0.0, 1.0
    return csr_array(dense)


@pytest.mark.parametrize("count", [1, 4, 9, 16])
def test_products(count, rng):
    matrix, values = matrix_of(37, 50, rng), rng.normal(size=(50, count)).astype(np.float32)
    with mitsuba() as mi:
        found = DeviceSparse(mi, matrix).multiply(values)
    assert_rounded(found, matrix @ values, 50, size=float((abs(matrix) @ np.abs(values)).max()))


@pytest.mark.parametrize(("rows", "columns"), [(0, 5), (3, 5)])
def test_a_matrix_of_nothing(rows, columns):
    with mitsuba() as mi:
        found = DeviceSparse(mi, csr_array((rows, columns), dtype=np.float32)).multiply(np.ones((columns, 3)))
    assert found.shape == (rows, 3)
    assert not found.any()


def test_several_threads(rng):
    matrix = matrix_of(20, 30, rng)
    pieces = [rng.normal(size=(30, 5)).astype(np.float32) for _ in range(12)]
    with mitsuba() as mi, ThreadPoolExecutor(4) as pool:
        device = DeviceSparse(mi, matrix)
        found = list(pool.map(device.multiply, pieces))
        for one, piece in zip(found, pieces, strict=True):
            assert_exact(one, device.multiply(piece), "the same kernel on the same machine")


def test_an_operator_that_was_used_can_be_sent(rng):
    gather = Gather(np.arange(1, 21), matrix_of(20, 30, rng), 0.0, 0.0, 5)
    values = rng.random((30, 2)).astype(np.float32)
    wanted = gather.reflected(np.full(30, 0.5, dtype=np.float32), values)
    again = pickle.loads(pickle.dumps(gather))
    assert_exact(again.reflected(np.full(30, 0.5, dtype=np.float32), values), wanted, "the same product")
