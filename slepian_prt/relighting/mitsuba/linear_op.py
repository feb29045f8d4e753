"""Linear maps of numpy arrays as operations of Dr.Jit, with gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray


def linear_op(
    apply: Callable[[NDArray], NDArray], adjoint: Callable[[NDArray], NDArray], value: Any, result_type: Any
) -> Any:
    """Apply a linear map; gradients go through it forward and, by its adjoint, backward.

    Parameters
    ----------
    apply, adjoint : callable
        The map and its transpose, of flat arrays.
    value : Dr.Jit array or tensor
    result_type : type
        Dr.Jit array type of the flat result.
    """
    import drjit as dr

    class Linear(dr.CustomOp):
        def eval(self, value: Any) -> Any:
            return result_type(_flat(apply(np.array(value).ravel())))

        def forward(self) -> None:
            self.set_grad_out(result_type(_flat(apply(np.array(self.grad_in("value")).ravel()))))

        def backward(self) -> None:
            gradient = dr.array_t(value)(_flat(adjoint(np.array(self.grad_out()).ravel())))
            self.set_grad_in("value", type(value)(gradient, value.shape) if dr.is_tensor_v(value) else gradient)

    return dr.custom(Linear, value)


def _flat(values: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32).ravel()
