"""Reflectance at points of a textured mesh, on Dr.Jit's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.reflectance.textures import decode_texture, image_size

# Texels that are kept in all, at 12 bytes each; larger textures are halved.
_MOST_TEXELS = 1 << 25

_WRAPS = ("repeat", "clamp", "mirror")


class TextureLookup:
    """The detail of a mesh, to be looked up where rays meet it.

    All textures lie in one array, so that a lookup costs the same however many there are, and each axis may continue in
    its own way; Mitsuba's ``bitmap`` would be one call for each, with one way for both axes.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the rays
    detail : SurfaceDetail
    """

    def __init__(self, mi: Any, detail: SurfaceDetail) -> None:
        self._mi, faces = mi, len(detail.choice)
        # A texture that is colour here and metal there is decoded twice; -1 is nothing.
        uses = sorted({(int(n), True) for n in detail.choice} | {(int(n), False) for n in detail.metallic_choice})
        uses = [use for use in uses if use[0] >= 0]
        sizes = [image_size(detail.textures[number]) for number, _ in uses]
        halvings = 0
        while sum((h >> halvings) * (w >> halvings) for h, w in sizes) > _MOST_TEXELS:
            halvings += 1
        images = [decode_texture(detail.textures[n], is_srgb=is_srgb, finest=halvings) for n, is_srgb in uses]
        slots = {use: slot for slot, use in enumerate(uses)}
        self._texels = mi.Float(_flat(np.float32, [image.reshape(-1) for image in images]))
        begins = np.cumsum([0, *(image.shape[0] * image.shape[1] for image in images)])[:-1]
        self._begin = mi.UInt32(_flat(np.uint32, [begins]))
        self._size = [mi.Int32(_flat(np.int32, [[image.shape[axis] for image in images]])) for axis in (1, 0)]
        wraps = [detail.textures[number].wrap for number, _ in uses]
        self._wrap = [mi.UInt32(_flat(np.uint32, [[_WRAPS.index(w[axis]) for w in wraps]])) for axis in (0, 1)]
        self._slots = [
            mi.Int32(np.array([slots.get((int(n), is_srgb), -1) for n in chosen], dtype=np.int32))
            for chosen, is_srgb in ((detail.choice, True), (detail.metallic_choice, False))
        ]
        self._uv = [mi.Float(uv.reshape(faces, 6).ravel()) for uv in (detail.uv, detail.metallic_uv)]
        self._colors = mi.Float(detail.colors.ravel())
        self._metallic = mi.Float(detail.metallic)

    def reflectance(self, face: Any, u: Any, v: Any, active: Any) -> Any:
        """Diffuse reflectance (Color3f) at places on faces.

        Parameters
        ----------
        face : UInt32
        u, v : Float
            Barycentric coordinates: weights of the second and third corner.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        weights = (1.0 - u - v, u, v)
        color = mi.Color3f(0.0)
        for corner, weight in enumerate(weights):
            color += weight * dr.gather(mi.Color3f, self._colors, 3 * face + corner, active)
        color *= self._lookup(0, face, weights, active)
        metal = dr.gather(mi.Float, self._metallic, face, active) * self._lookup(1, face, weights, active).z
        return dr.clip(color * (1.0 - metal), 0.0, 1.0)

    def _lookup(self, which: int, face: Any, weights: Any, active: Any) -> Any:
        """Bilinear in the texture of colour (0) or metal (1) of each face; 1 where it has none."""
        import drjit as dr

        mi = self._mi
        slot = dr.gather(mi.Int32, self._slots[which], face, active)
        has = active & (slot >= 0)
        slot = mi.UInt32(dr.maximum(slot, 0))
        low, part, size, wrap = [], [], [], []
        for axis in (0, 1):
            place = mi.Float(0.0)
            for corner, weight in enumerate(weights):
                place += weight * dr.gather(mi.Float, self._uv[which], 6 * face + (2 * corner + axis), has)
            size.append(dr.gather(mi.Int32, self._size[axis], slot, has))
            wrap.append(dr.gather(mi.UInt32, self._wrap[axis], slot, has))
            # Within two images, after which each way to continue is as before: indices of many are not exact.
            clamped = wrap[axis] == _WRAPS.index("clamp")
            place = dr.select(clamped, dr.clip(place, -1.0, 2.0), place - 2.0 * dr.floor(0.5 * place))
            place = place * mi.Float(size[axis]) - 0.5
            low.append(dr.floor(place))
            part.append(place - low[axis])
        begin = dr.gather(mi.UInt32, self._begin, slot, has)
        total = mi.Color3f(0.0)
        for down in (0, 1):
            row = self._wrapped(mi.Int32(low[1]) + down, size[1], wrap[1])
            for right in (0, 1):
                column = self._wrapped(mi.Int32(low[0]) + right, size[0], wrap[0])
                texel = begin + mi.UInt32(row * size[0] + column)
                weight = (part[0] if right else 1.0 - part[0]) * (part[1] if down else 1.0 - part[1])
                total += weight * dr.gather(mi.Color3f, self._texels, texel, has)
        return dr.select(has, total, mi.Color3f(1.0))

    def _wrapped(self, index: Any, size: Any, wrap: Any) -> Any:
        """Indices of texels within the image."""
        import drjit as dr

        size = dr.maximum(size, 1)
        period = dr.select(wrap == _WRAPS.index("mirror"), 2 * size, size)
        turned = index - period * self._mi.Int32(dr.floor(self._mi.Float(index) / self._mi.Float(period)))
        turned = dr.select(turned < 0, turned + period, dr.select(turned >= period, turned - period, turned))
        turned = dr.select(turned < size, turned, 2 * size - 1 - turned)
        return dr.select(wrap == _WRAPS.index("clamp"), dr.clip(index, 0, size - 1), turned)


def _flat(kind: Any, pieces: list[Any]) -> NDArray:
    """One array of all pieces, never empty: Dr.Jit gathers from none."""
    joined = np.concatenate([np.zeros(0, dtype=kind), *(np.asarray(piece, dtype=kind).ravel() for piece in pieces)])
    return joined if joined.size else np.zeros(3, dtype=kind)
