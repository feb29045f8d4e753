import numpy as np
import pytest

from slepian_prt.relighting.mitsuba.linear_op import linear_op
from slepian_prt.renderer.variants import mitsuba


@pytest.mark.parametrize("kind", ["array", "tensor"])
def test_gradients_are_those_of_the_matrix(kind, rng):
    """Forward M v, backward Mᵀ w, for M that is known."""
    matrix = rng.normal(size=(5, 6))
    given, along, weights = (rng.normal(size=n).astype(np.float32) for n in (6, 6, 5))
    with mitsuba() as mi:
        import drjit as dr

        def leaf(values):
            return mi.Float(values) if kind == "array" else mi.TensorXf(values.reshape(2, 3))

        value = leaf(given)
        dr.enable_grad(value)
        product = linear_op(lambda v: matrix @ v, lambda w: matrix.T @ w, value, mi.Float)
        np.testing.assert_allclose(np.array(product), matrix @ given, rtol=1e-5, atol=1e-6)
        dr.backward(dr.sum(product * mi.Float(weights)))
        gradient = np.array(dr.grad(value))
        assert gradient.shape == np.shape(np.array(value))
        np.testing.assert_allclose(gradient.ravel(), matrix.T @ weights, rtol=1e-5, atol=1e-6)

        value = leaf(given)
        dr.enable_grad(value)
        dr.set_grad(value, leaf(along))
        product = linear_op(lambda v: matrix @ v, lambda w: matrix.T @ w, value, mi.Float)
        np.testing.assert_allclose(np.array(dr.forward_to(product)), matrix @ along, rtol=1e-5, atol=1e-6)
