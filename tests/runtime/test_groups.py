import numpy as np

from slepian_prt.relighting.factors import Factors
from slepian_prt.runtime.energies import DegreeEnergies
from slepian_prt.runtime.groups import group_caps
from slepian_prt.sphere.harmonics import degrees, num_coefficients

BANDLIMIT = 4


def caps(rng, channels: int):
    """Caps of several sizes, one of them without receivers, and the whole matrix."""
    members = np.split(rng.permutation(90), [30, 30, 70])
    parts, whole = [], np.zeros((90, channels, num_coefficients(BANDLIMIT)))
    for own in members:
        rank = int(rng.integers(2, 7))
        functions = rng.normal(size=(rank, channels, num_coefficients(BANDLIMIT))).astype(np.float32)
        part = Factors(rng.normal(size=(len(own), rank)).astype(np.float32), functions)
        whole[own] = np.einsum("nr,rcm->ncm", part.coefficients, functions)
        parts.append(part)
    return parts, members, whole


def test_groups_hold_what_caps_do(rng):
    weights = 1.0 / (1.0 + degrees(BANDLIMIT))
    for channels in (1, 3):
        parts, members, whole = caps(rng, channels)
        active = rng.random(90) > 0.2
        for most in (2, 4):
            groups = group_caps(parts, members, active, weights, most)
            assert len(groups) == min(most, 3)  # one has no receivers
            found = np.concatenate([group.members for group in groups])
            assert sorted(found) == np.flatnonzero(active).tolist()
            for group in groups:
                vectors = (group.values @ group.functions).reshape(len(group.members), channels, -1)
                # Products of float32 with some tens of functions.
                np.testing.assert_allclose(vectors, whole[group.members], atol=2e-5)
                weighted = (group.functions.reshape(len(group.functions), channels, -1) * weights).reshape(
                    len(group.functions), -1
                )
                np.testing.assert_allclose(weighted @ weighted.T, np.eye(len(weighted)), atol=1e-5)
                energies = np.sum(group.values.astype(float) ** 2, axis=0)
                assert np.all(np.diff(energies) <= 1e-5 * energies[0])


def test_caps_without_functions(rng):
    """Where no light arrives: alone, and beside others."""
    weights = np.ones(num_coefficients(BANDLIMIT))
    for channels in (1, 3):
        dark = Factors(np.zeros((5, 0), np.float32), np.zeros((0, channels, weights.size), np.float32))
        parts, members, _ = caps(rng, channels)
        alone = group_caps([dark], [np.arange(5)], np.ones(5, dtype=bool), weights, 2)
        assert [group.values.shape for group in alone] == [(5, 0)]
        assert alone[0].functions.shape == (0, channels * weights.size)
        active = np.ones(95, dtype=bool)
        for most in (2, 9):
            groups = group_caps([*parts, dark], [*members, np.arange(90, 95)], active, weights, most)
            assert sorted(np.concatenate([group.members for group in groups])) == list(range(95))


def test_energies_by_degree(rng):
    total, wanted = DegreeEnergies(BANDLIMIT), np.zeros(BANDLIMIT + 1)
    for channels in (3, 3):
        coefficients = rng.normal(size=(40, 6)).astype(np.float32)
        functions = rng.normal(size=(6, channels * num_coefficients(BANDLIMIT)))
        total.add(coefficients, functions)
        vectors = (coefficients @ functions).reshape(40, channels, -1)
        wanted += np.bincount(degrees(BANDLIMIT), np.sum(vectors**2, axis=(0, 1)))
    np.testing.assert_allclose(total.sums, wanted, rtol=1e-5)  # the Gram matrix is of float32
