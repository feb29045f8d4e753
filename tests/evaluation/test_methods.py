import pytest

from slepian_prt.compression.bases import BASES
from slepian_prt.errors import UserError
from slepian_prt.evaluation.methods import DEFAULT_METHODS, METHODS, check_methods


def test_every_basis_is_a_method_and_variants_follow_it():
    assert set(BASES) < set(METHODS)
    names = list(METHODS)
    for name in names:
        basis = name.partition("+")[0]
        assert basis == name or names.index(basis) < names.index(name)
    assert set(DEFAULT_METHODS) < set(METHODS)


def test_by_default_a_handful_is_compared():
    """For a fraction of the time that all take."""
    assert len(DEFAULT_METHODS) <= 5
    assert 3 * sum(METHODS[name].cost for name in DEFAULT_METHODS) < sum(method.cost for method in METHODS.values())


def test_curves_can_be_told_apart():
    """Without colour too: by marker and dash."""
    assert len({method.style for method in METHODS.values()}) == len(METHODS)
    marks = [(method.style.marker, method.style.dash) for method in METHODS.values()]
    assert len(set(marks)) == len(marks)


@pytest.mark.parametrize(("name", "message"), [("none", "full SH"), ("wavelets", "basis must be one of adapted, ")])
def test_unknown_methods(name, message):
    with pytest.raises(UserError, match=message):
        check_methods(["adapted", name])
