import math

import numpy as np
import pytest

from scripts.paper.closure import (
    gram_in_cap,
    hemispherical_gram_in_cap,
    lost_by_hemispherical,
    lost_by_rotation,
    off_diagonal,
)
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.sphere.hemispherical import h_basis_in_sh, hemispherical_sh
from slepian_prt.sphere.quadrature import spherical_fibonacci

HALF = math.pi / 2.0


def test_slepian_functions_are_orthogonal_over_the_cap_and_the_sphere():
    functions = cap_basis(6, 0.6).functions.T
    assert off_diagonal(gram_in_cap(functions, 0.6)) < 1e-13
    assert off_diagonal(functions @ functions.T) < 1e-13
    assert off_diagonal(gram_in_cap(functions, 0.5)) > 0.1


def test_hemispherical_ones_are_over_the_hemisphere_only():
    assert off_diagonal(hemispherical_gram_in_cap(3, HALF)) < 1e-13
    assert off_diagonal(hemispherical_gram_in_cap(3, 0.6)) > 0.3
    assert off_diagonal(gram_in_cap(h_basis_in_sh(9), HALF)) < 1e-13
    assert off_diagonal(gram_in_cap(h_basis_in_sh(9), math.pi)) > 0.3


@pytest.mark.parametrize("angle", [0.2, 1.0, HALF])
def test_whole_degrees_are_closed_under_rotation(angle):
    assert abs(lost_by_rotation(np.eye(16), angle)) < 1e-13
    assert abs(lost_by_rotation(cap_basis(4, 0.5).functions.T, angle)) < 1e-13
    assert abs(lost_by_rotation(h_basis_in_sh(9), angle)) < 1e-13
    assert lost_by_rotation(h_basis_in_sh(6), angle) > 1e-3


def test_one_function_loses_what_its_own_rotation_tells():
    """z turned by α about x is z cos α - y sin α: sin²α is lost."""
    assert lost_by_rotation(np.eye(4)[2:3], 0.7) == pytest.approx(math.sin(0.7) ** 2, abs=1e-14)


def test_constant_of_the_hemisphere_loses_what_goes_below_the_horizon():
    """The lune of π - α has the part 1 - α/π of the area; its mean is kept, squared."""
    lost, of_the_rest = lost_by_hemispherical(0, 0.7)
    assert lost == pytest.approx(1.0 - (1.0 - 0.7 / math.pi) ** 2, abs=1e-12)
    assert of_the_rest == pytest.approx(0.7 / math.pi, abs=1e-12)


def test_not_turned_nothing_is_lost():
    assert np.abs(lost_by_hemispherical(3, 0.0)).max() < 1e-12


def test_lost_energy_against_a_fine_set_of_directions():
    directions, angle = spherical_fibonacci(200_000), 0.5
    c, s = math.cos(angle), math.sin(angle)
    back = directions @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    both = (directions[:, 2] > 0.0) & (back[:, 2] > 0.0)
    products = hemispherical_sh(2, directions[both]).T @ hemispherical_sh(2, back[both]) * (4.0 * math.pi / 200_000)
    assert lost_by_hemispherical(2, angle)[0] == pytest.approx(1.0 - np.sum(products**2) / 9, abs=1e-4)
