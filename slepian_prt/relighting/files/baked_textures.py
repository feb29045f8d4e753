"""What materials of a Mitsuba scene reflect diffusely, as images."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.drawing.pictures import encode_srgb
from slepian_prt.scene.formats.parts import Texture, Wrap
from slepian_prt.scene.reflectance.bsdf_parts import PERTURBING, parts_of, varies
from slepian_prt.scene.reflectance.diffuse_lobe import diffuse_albedo

# Texels along a checkerboard, which has no image of its own: its edges are so sharp.
_CHECKS = 256

_WRAPS: tuple[Wrap, ...] = ("repeat", "mirror", "clamp")
_PROBES = 64

# Texels that are evaluated at once.
_TEXELS = 1 << 22


class BakedTexture(NamedTuple):
    """The diffuse reflectance of a material as an image.

    Attributes
    ----------
    texture : Texture
    to_uv : (3, 3)
        From texture coordinates of the shape to those of the image.
    """

    texture: Texture
    to_uv: NDArray[np.float64]

    def coordinates(self, uv: NDArray) -> NDArray[np.float64]:
        """(…, 2) where the image has what the shape has at ``uv``."""
        return _affine(self.to_uv, uv)

    def is_same(self, other: BakedTexture) -> bool:
        """Whether another one shows the same."""
        a, b = self.texture, other.texture
        return a.source == b.source and a.wrap == b.wrap and bool(np.all(self.to_uv == other.to_uv))


def bake_texture(mi: Any, bsdf: Any, name: str, *, side: int = 1) -> BakedTexture | None:
    """What a BSDF reflects diffusely, where bitmaps or checkerboards that lie on each other say it.

    Parameters
    ----------
    mi : Mitsuba, in an RGB variant
    bsdf : Mitsuba BSDF
    name : str
        Of the shape, for messages.
    side : 1 or -1
        With -1 it is seen from behind.

    Returns
    -------
    None where other textures are in it, or some with other coordinates.
    """
    textures = list(_textures_in(mi, bsdf, side))
    shown = [mi.traverse(texture) for texture in textures]
    if not textures or not all("to_uv" in parameters for parameters in shown):
        return None
    to_uv = [np.array(parameters["to_uv"].matrix, dtype=np.float64).reshape(3, 3) for parameters in shown]
    if np.abs(np.array(to_uv) - to_uv[0]).max() > 0.0 or np.linalg.det(to_uv[0]) == 0.0:
        return None
    sizes = [parameters["data"].shape[:2] if "data" in parameters else (_CHECKS, _CHECKS) for parameters in shown]
    inverse = np.linalg.inv(to_uv[0])

    def reflected(uv: NDArray) -> NDArray[np.float64]:
        return _reflectance(mi, bsdf, _affine(inverse, uv), side)

    height, width = np.max(sizes, axis=0).tolist()
    wrap = _wrap_of(reflected)
    return BakedTexture(Texture(f"of shape '{name}'", _png_of(reflected, height, width), (wrap, wrap)), to_uv[0])


def _textures_in(mi: Any, bsdf: Any, side: int) -> Iterator[Any]:
    """Textures of a BSDF, as it is seen from that side, that are not the same everywhere."""
    for name, part in parts_of(mi, bsdf).items():
        if bsdf.class_name() == "TwoSidedBRDF" and name != ("brdf_0" if side > 0 else "brdf_1"):
            continue
        if isinstance(part, mi.BSDF):
            yield from _textures_in(mi, part, side)
        elif bsdf.class_name() not in PERTURBING and varies(part):
            yield part


def _png_of(reflected: Callable[[NDArray], NDArray], height: int, width: int) -> bytes:
    """An image of what is reflected at the middles of its texels, in sRGB."""
    from PIL import Image

    columns, encoded = (np.arange(width) + 0.5) / width, np.empty((height, width, 3), dtype=np.uint8)
    each = max(_TEXELS // width, 1)
    for first in range(0, height, each):
        rows = (np.arange(first, min(first + each, height)) + 0.5) / height
        uv = np.stack(np.broadcast_arrays(columns, rows[:, None]), axis=-1).reshape(-1, 2)
        linear = np.clip(np.nan_to_num(reflected(uv)), 0.0, 1.0)
        encoded[first : first + each] = (encode_srgb(linear) * 255.0 + 0.5).reshape(len(rows), width, 3)
    stream = io.BytesIO()
    Image.fromarray(encoded).save(stream, "PNG")
    return stream.getvalue()


def _wrap_of(reflected: Callable[[NDArray], NDArray]) -> Wrap:
    """How a bitmap continues, which Mitsuba does not tell: as what it looks like beyond its border."""
    rng = np.random.default_rng(0)
    beyond = rng.random((_PROBES, 2)) + rng.integers(-2, 3, (_PROBES, 2))
    folded = np.abs((beyond + 1.0) % 2.0 - 1.0)
    seen, *expected = map(reflected, (beyond, beyond % 1.0, folded, np.clip(beyond, 0.0, 1.0)))
    return _WRAPS[int(np.argmin([np.median(np.abs(one - seen).max(axis=1)) for one in expected]))]


def _reflectance(mi: Any, bsdf: Any, uv: NDArray, side: int) -> NDArray[np.float64]:
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv = mi.Point2f(uv.T.astype(np.float32))
    return diffuse_albedo(mi, bsdf, si, side=side)


def _affine(matrix: NDArray, uv: NDArray) -> NDArray[np.float64]:
    return np.asarray(uv @ matrix[:2, :2].T + matrix[:2, 2])
