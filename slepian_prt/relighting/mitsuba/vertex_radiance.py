"""Radiance of a file's vertices under the light of a Mitsuba scene, computed again when that changes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.relighting.mitsuba.device_operator import DeviceOperator
from slepian_prt.relighting.mitsuba.emission import EnvmapTables, distant_light
from slepian_prt.relighting.mitsuba.linear_op import linear_op
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.relighting.relight import NOISE, negative_fraction
from slepian_prt.renderer import variants
from slepian_prt.sphere.harmonics import degrees


class VertexRadiance:
    """Radiance of the vertices of a file for unit albedo, on Mitsuba's arrays.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    packed : CompressedTransfer
    turn : (3, 3)
        Rotation from the scene to the world of the file.
    damping : (L+1,)
        Factor of each degree of the light.
    lighting : (3, (L+1)²), optional
        Light in the world of the file, in place of that of emitters.
    on_device : bool, optional
        Whether all of it is made by Dr.Jit, where the arrays are. By default under CUDA; processors are quicker with
        NumPy's products.

    Attributes
    ----------
    negative : float
        Fraction of the vertices that were negative under the last light, see `negative_fraction`.
    """

    def __init__(
        self,
        mi: Any,
        packed: CompressedTransfer,
        turn: NDArray[np.float64],
        damping: NDArray[np.float64],
        lighting: NDArray[np.float64] | None = None,
        *,
        on_device: bool | None = None,
    ) -> None:
        self._mi, self._packed, self._turn = mi, packed, turn
        self._damping = np.tile(damping[degrees(packed.bandlimit)], 3).astype(np.float32)
        self._on_device = variants.is_on_device(mi) if on_device is None else on_device
        self._operator: DeviceOperator | None = None
        self._tables = EnvmapTables() if self._on_device else None
        self.negative = 0.0
        self._last_emitter: dict[str, Any] | None = None
        self._last_radiance: Any = None
        self._of_lighting: Any = None
        if lighting is not None:
            self._of_lighting = self._relight(mi.Float(lighting.astype(np.float32).ravel()))
            self.negative = self._negative_fraction(self._of_lighting)

    def under(self, emitter: Any) -> Any:
        """(3 V,) flat Float; what was computed last if the emitter is as it was then. Without emitter, zeros."""
        import drjit as dr

        mi = self._mi
        if self._of_lighting is not None:
            return self._of_lighting
        if emitter is None:
            return dr.zeros(mi.Float, self._packed.mesh.albedo.size)
        state = _parameters(mi, emitter)
        if self._last_emitter is not None and _unchanged(self._last_emitter, state):
            return self._last_radiance
        radiance = self._relight(distant_light(mi, emitter, self._packed.bandlimit, self._turn, self._tables))
        if not dr.grad_enabled(radiance):
            self._last_emitter, self._last_radiance = state, radiance
            self.negative = self._negative_fraction(radiance)
        return radiance

    def _negative_fraction(self, radiance: Any) -> float:
        """`negative_fraction` of flat radiance."""
        import drjit as dr

        if not self._on_device:
            return negative_fraction(np.array(radiance).reshape(-1, 3))
        lowest = dr.min(dr.unravel(self._mi.Vector3f, radiance))
        below: Any = dr.mean(dr.select(lowest < -NOISE * dr.maximum(dr.max(radiance), 0.0), 1.0, 0.0))
        return float(below[0])

    def _relight(self, light: Any) -> Any:
        operator, damping = transfer_operator(self._packed), self._mi.Float(self._damping)
        if self._on_device:
            if self._operator is None:
                self._operator = DeviceOperator(self._mi, operator)
            return self._operator.radiance(light * damping)

        def apply(lighting: NDArray) -> NDArray:
            return operator.apply(lighting.reshape(1, 3, -1))[0]

        def adjoint(gradient: NDArray) -> NDArray:
            return operator.adjoint(gradient.reshape(1, -1, 3))[0]

        return linear_op(apply, adjoint, light * damping, self._mi.Float)


def _parameters(mi: Any, emitter: Any) -> dict[str, Any]:
    """What ``mi.traverse`` gives, copied, since that changes with the emitter; of arrays only their handles are."""
    import drjit as dr

    return {
        name: type(value)(value) if dr.is_array_v(value) else repr(value)
        for name, value in mi.traverse(emitter).items()
    }


def _unchanged(before: dict[str, Any], now: dict[str, Any]) -> bool:
    """Whether the parameters of an emitter are the same; not so while gradients are followed."""
    return list(before) == list(now) and all(_same(before[name], now[name]) for name in now)


def _same(old: Any, new: Any) -> bool:
    import drjit as dr

    if type(old) is not type(new):
        return False
    if not dr.is_array_v(new):
        return bool(old == new)
    if dr.grad_enabled(new) or old.shape != new.shape:
        return False
    a, b = (x.array if dr.is_tensor_v(x) else x for x in (old, new))
    # Equal indices are the same array in memory; others are compared, which is still faster than relighting.
    return getattr(a, "index", -1) == getattr(b, "index", -2) or bool(np.all(np.array(dr.all(a == b, axis=None))))
