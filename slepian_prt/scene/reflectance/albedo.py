"""What the materials of a mesh file reflect at its vertices.

Light is computed at vertices, so a texture counts there by its mean over the faces around a vertex, each point weighted
as interpolation from the vertex weights it, and not by the one texel that the vertex happens to hit.
"""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.parts import Material, MeshPart, Texture
from slepian_prt.scene.left_out import GATHERED, TEXTURE_LOST, LeftOut
from slepian_prt.scene.normals import face_areas
from slepian_prt.scene.reflectance.barycentric import points_on
from slepian_prt.scene.reflectance.textures import FilteredTexture, image_size, usable_uv

log = logging.getLogger(__name__)

# A texture is looked at so often in all, more for very many faces. Each lookup takes the mean over a quarter of what
# belongs to it: whole patches reach over the borders of what an atlas holds, which is a few per cent of the albedo.
_LOOKUPS = 1e6
_PATCH = 0.25

# Textures are kept as fine as this part of the faces needs; finer ones take the mean of a little more than their own.
_FINEST_FACES = 0.1

# Metal below this part of a material is not worth a remark.
_METALLIC = 0.01

# What is decoded, by the identity of the texture and whether it is sRGB; None for what cannot be used.
Textures = dict[tuple[int, bool], FilteredTexture | None]


class _Use(NamedTuple):
    """A texture on a part, with the coordinates (F, 3, 2) of the corners of its faces."""

    texture: Texture
    uv: NDArray[np.float64]
    is_srgb: bool

    @property
    def key(self) -> tuple[int, bool]:
        return id(self.texture), self.is_srgb

    def areas(self) -> NDArray[np.float64]:
        """(F,) parts of the image that are averaged about each point of a face that it is looked at."""
        a, b = self.uv[:, 1] - self.uv[:, 0], self.uv[:, 2] - self.uv[:, 0]
        share = _PATCH / len(points_on(len(self.uv), _LOOKUPS))
        return np.asarray(0.5 * share * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def decode_textures(parts: Sequence[MeshPart]) -> Textures:
    """Decode what the materials of all parts refer to, each once and as fine as the finest of its uses needs it.

    What cannot be used is remarked on: reflectance counts as white then, and metal as none.
    """
    uses: defaultdict[tuple[int, bool], list[_Use]] = defaultdict(list)
    for part in parts:
        for use in (_color_use(part), _metal_use(part)):
            if use is not None and len(use.uv):
                uses[use.key].append(use)
        if part.uv is None and part.material is not None and part.material.texture is not None:
            log.info("texture %s is left out of '%s', which has no coordinates", part.material.texture.name, part.name)
    return {key: _decoded(same) for key, same in uses.items()}


def _decoded(uses: Sequence[_Use]) -> FilteredTexture | None:
    texture, is_srgb = uses[0].texture, uses[0].is_srgb
    try:
        height, width = image_size(texture)
        area = min(float(np.quantile(use.areas(), _FINEST_FACES)) for use in uses)
        finest = int(0.5 * math.log2(max(1.0, area * height * width)))
        return FilteredTexture(texture, is_srgb=is_srgb, finest=finest)
    except UserError as error:
        log.info("%s; %s", error, "it counts as white" if is_srgb else "what it covers counts as not metallic")
        return None


def _color_use(part: MeshPart) -> _Use | None:
    return _use(part.material.texture if part.material else None, part.uv, True)


def _metal_use(part: MeshPart) -> _Use | None:
    material = part.material
    if material is None or material.metallic <= 0.0:
        return None
    return _use(material.metallic_texture, part.uv if part.metallic_uv is None else part.metallic_uv, False)


def _use(texture: Texture | None, uv: NDArray | None, is_srgb: bool) -> _Use | None:
    if texture is None or uv is None:
        return None
    return _Use(texture, usable_uv(uv), is_srgb)


def vertex_albedo(part: MeshPart, textures: Textures) -> tuple[NDArray[np.float32], float]:
    """(V, 3) diffuse reflectance of a part, and the metallic part of its area, which reflects nothing diffusely.

    ``textures`` are those of `decode_textures`.
    """
    count, material = len(part.positions), part.material or Material("")
    area, looks = face_areas(part.positions, part.faces), _looks(part, textures)
    if not looks:
        albedo = np.broadcast_to(np.array(material.color) * (1.0 - material.metallic), (count, 3))
        metallic = material.metallic
    else:
        total, weights, metallic = np.zeros((count, 3)), np.zeros(count), 0.0
        for barycentric, look in looks:
            value, share = look()
            metallic += float(share @ area) / max(len(looks) * float(area.sum()), 1e-300)
            for k in range(3):
                weight = area * barycentric[k]
                weights += np.bincount(part.faces[:, k], weight, minlength=count)
                for axis in range(3):
                    total[:, axis] += np.bincount(part.faces[:, k], weight * value[:, axis], minlength=count)
        albedo = total / np.maximum(weights, 1e-300)[:, None]
    if part.colors is not None:
        albedo = albedo * part.colors
    albedo = np.where(np.isfinite(albedo), albedo, 0.0)
    return np.clip(albedo, 0.0, 1.0).astype(np.float32), metallic


def texture_lost(part: MeshPart, textures: Textures, albedo: NDArray) -> float:
    """Relative RMS over the faces by which what is interpolated from vertices (V, 3) is off from a textured albedo."""
    area, squared, power = face_areas(part.positions, part.faces), 0.0, 0.0
    for barycentric, look in _looks(part, textures):
        value, _ = look()
        if part.colors is not None:
            value = value * np.einsum("fkc,k->fc", part.colors[part.faces], barycentric)
        between = np.einsum("fkc,k->fc", albedo[part.faces], barycentric)
        squared += float(area @ np.square(value - between).sum(axis=1))
        power += float(area @ np.square(value).sum(axis=1))
    return math.sqrt(squared / max(power, 1e-300))


_Look = Callable[[], tuple[NDArray[np.float64], NDArray[np.float64]]]


def _looks(part: MeshPart, textures: Textures) -> list[tuple[NDArray[np.float64], _Look]]:
    """Points of each face, (3,) barycentric, and what is found there; none of a part without textures.

    That are (F, 3) diffuse reflectances, without the colours of vertices, and (F,) metallic parts.
    """
    material = part.material or Material("")
    color, metal = (_lookup(use, textures) for use in (_color_use(part), _metal_use(part)))
    factor = 0.0 if material.metallic_texture is not None and metal is None else material.metallic
    if color is None and metal is None and factor == material.metallic:
        return []

    def look(barycentric: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        value = np.broadcast_to(material.color, (len(part.faces), 3))
        share = np.full(len(part.faces), factor)
        if color is not None:
            value = value * color(barycentric)
        if metal is not None:
            share = share * metal(barycentric)[:, 2]
        return value * (1.0 - share)[:, None], share

    return [(barycentric, partial(look, barycentric)) for barycentric in points_on(len(part.faces), _LOOKUPS)]


def _lookup(use: _Use | None, textures: Textures) -> Callable[[NDArray], NDArray[np.float32]] | None:
    """A function that gives (F, 3) means of a texture over the pieces of the faces about a point of them."""
    texture = None if use is None else textures.get(use.key)
    if use is None or texture is None:
        return None
    areas = use.areas()
    return lambda barycentric: texture.mean(np.einsum("fkc,k->fc", use.uv, barycentric), areas)


def effects_left_out(
    parts: Sequence[MeshPart], metallic: Sequence[float], lost: Sequence[float] | None = None
) -> tuple[LeftOut, ...]:
    """What of the materials of a mesh file vertices do not hold; ``lost`` is as of `texture_lost`, for each part."""
    areas = np.array([face_areas(part.positions, part.faces).sum() for part in parts])
    whole = max(float(areas.sum()), 1e-300)
    named: defaultdict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for part, area in zip(parts, areas, strict=True):
        for effect in part.material.not_simulated if part.material else ():
            named[effect][part.material.name if part.material else ""] += area / whole
    rows = [LeftOut(f"{effect} of {_listed(names)}", sum(names.values())) for effect, names in named.items()]
    share = float(areas @ np.array(metallic)) / whole
    if share > _METALLIC:
        metals = [part.material.name for part, m in zip(parts, metallic, strict=True) if part.material and m > 0.5]
        name = f"metallic reflection of {_listed(dict.fromkeys(metals))}" if metals else "metallic reflection"
        reason = "metals have no diffuse part and stay dark; `albedo` lights the whole model as if it were diffuse"
        rows.insert(0, LeftOut(name, share, reason))
    coarse = np.array([0.0] * len(parts) if lost is None else lost)
    coarse = np.where(coarse >= TEXTURE_LOST, coarse, 0.0)
    if coarse.any():
        names = dict.fromkeys(part.material.name for part, x in zip(parts, coarse, strict=True) if x and part.material)
        missing = math.sqrt(float(areas @ coarse**2) / float(areas[coarse > 0.0].sum()))
        reason = (
            "relative RMS by which albedo differs from what vertices hold, for .npz and for light between surfaces; "
            "pictures take the texture at each pixel"
        )
        rows.append(LeftOut(f"texture between vertices of {_listed(names)}", missing, reason, GATHERED))
    return tuple(rows)


def _listed(names: Iterable[str], most: int = 3) -> str:
    """A few materials by name, more by number."""
    names = [name for name in names if name]
    shown = ", ".join(f"'{name}'" for name in names[:most])
    if len(names) > most:
        return f"{len(names)} materials ({shown}, …)"
    return f"material {shown}" if len(names) == 1 else f"materials {shown}" if names else "a material without a name"
