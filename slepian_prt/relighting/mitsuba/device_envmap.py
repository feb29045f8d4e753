"""Texels of an ``envmap`` as spherical harmonics on Mitsuba's arrays: `TexelProjection`, as products of Dr.Jit.

Along each row a sum with cosines and sines, over the rows one with Legendre functions, and the rotation into the world;
in float64, for maps with suns. Gradients follow by themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slepian_prt.lighting.emitters import BRIGHTEST, check_radiance
from slepian_prt.lighting.texel_projection import TexelProjection


class DeviceEnvmap:
    """The linear map from the data of an ``envmap`` to coefficients of its light.

    Parameters
    ----------
    mi : Mitsuba
    projection : TexelProjection
    mirrored : bool
        Whether the map is turned left to right.
    """

    def __init__(self, mi: Any, projection: TexelProjection, *, mirrored: bool) -> None:
        import drjit as dr

        tensor: Any = dr.float64_array_t(mi.TensorXf)
        self._mi, self._tensor = mi, tensor
        along, across = projection.matrices()
        if mirrored:
            along = along[:, ::-1]
        # Mitsuba repeats the last column before the first, and the first behind the last: these count nothing.
        self._along = self._tensor(np.pad(along, ((0, 0), (1, 1))))
        self._across = self._tensor(across)
        self._rotation = self._tensor(projection.rotation_of_sums())

    def light(self, data: Any) -> Any:
        """Float (C (L+1)²), channel after channel, of texels (H, W + 2, C).

        Raises
        ------
        UserError
            Radiance that is not finite or too bright.
        """
        import drjit as dr

        texels = dr.detach(data.array)
        if not bool(dr.all(dr.isfinite(texels) & (dr.abs(texels) <= BRIGHTEST))[0]):
            check_radiance(np.array(texels), "envmap")
        # (2L+1, W+2) times (H, W+2, C), then for each order (L+1, H) times (H, C).
        sums: Any = dr.matmul(self._along, self._tensor(data))
        sums = dr.matmul(self._across, dr.moveaxis(sums, 1, 0))
        sums = dr.reshape(sums, (self._rotation.shape[1], data.shape[2]))
        light: Any = dr.matmul(sums, self._rotation, At=True, Bt=True)
        return self._mi.Float(light.array)
