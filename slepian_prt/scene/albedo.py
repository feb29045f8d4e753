"""What the materials of a mesh file reflect at its vertices.

Light is computed at vertices, so a texture counts there by its mean over the faces around a vertex, each point weighted
as interpolation from the vertex weights it, and not by the one texel that the vertex happens to hit.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.parts import Material, MeshPart, Texture
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.textures import FilteredTexture, image_size

log = logging.getLogger(__name__)

# Along each side of a face, points that a texture is looked at; between them it is filtered.
_POINTS = 4

# Textures are kept as fine as this part of the faces needs; finer ones take the mean of a little more than their own.
_FINEST_FACES = 0.1

# Metal below this part of a material is not worth a remark.
_METALLIC = 0.01

Textures = dict[int, "FilteredTexture | None"]


def _barycentric_grid(n: int) -> NDArray[np.float64]:
    """(n², 3) centres of the n² equal triangles that a triangle is cut into."""
    up = [(3 * i + 1, 3 * j + 1) for i in range(n) for j in range(n - i)]
    down = [(3 * i + 2, 3 * j + 2) for i in range(n) for j in range(n - i - 1)]
    first = np.array(up + down) / (3.0 * n)
    return np.column_stack([1.0 - first.sum(axis=1), first])


_GRID = _barycentric_grid(_POINTS)


def vertex_albedo(part: MeshPart, textures: Textures) -> tuple[NDArray[np.float32], float]:
    """(V, 3) diffuse reflectance of a part, and the metallic part of its area, which reflects nothing diffusely.

    ``textures`` holds what other parts had decoded, by the identity of the texture; None for what cannot be.
    """
    count, material = len(part.positions), part.material or Material("")
    # Of faces around a vertex, and over the faces: the integral of each corner's weight is a third of the area.
    corner = part.positions[part.faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    weights = np.stack([np.bincount(part.faces[:, k], area, minlength=count) for k in range(3)]).sum(axis=0) / 3.0
    color = np.array(material.color, dtype=np.float64)
    texture = _filtered(material.texture, part.uv, True, textures)
    metal_uv = part.uv if part.metallic_uv is None else part.metallic_uv
    metal = _filtered(material.metallic_texture, metal_uv, False, textures) if material.metallic > 0.0 else None
    if texture is None and metal is None:
        albedo = np.broadcast_to(color * (1.0 - material.metallic), (count, 3))
        metallic = material.metallic
    else:
        total, metallic = np.zeros((count, 3)), 0.0
        for barycentric in _GRID:
            value = np.broadcast_to(color, (len(part.faces), 3))
            if texture is not None:
                value = value * _mean_around(texture, part.uv, barycentric)
            share = np.full(len(part.faces), material.metallic)
            if metal is not None:
                share = share * _mean_around(metal, metal_uv, barycentric)[:, 2]
            metallic += float(share @ area) / len(_GRID) / max(float(area.sum()), 1e-300)
            value = value * (1.0 - share)[:, None]
            for k in range(3):
                for axis in range(3):
                    weighted = area * barycentric[k] / len(_GRID) * value[:, axis]
                    total[:, axis] += np.bincount(part.faces[:, k], weighted, minlength=count)
        albedo = total / np.maximum(weights, 1e-300)[:, None]
    if part.colors is not None:
        albedo = albedo * part.colors
    albedo = np.where(np.isfinite(albedo), albedo, 0.0)
    return np.clip(albedo, 0.0, 1.0).astype(np.float32), metallic


def _filtered(texture: Texture | None, uv: NDArray | None, is_srgb: bool, textures: Textures) -> FilteredTexture | None:
    """The texture for lookups, decoded once; None without one, or if it cannot be used."""
    if texture is None or uv is None:
        return None
    if id(texture) not in textures:
        try:
            height, width = image_size(texture)
            each = _texels(uv, height, width) / _POINTS**2
            finest = int(max(0.0, 0.5 * np.log2(max(1.0, float(np.quantile(each, _FINEST_FACES))))))
            textures[id(texture)] = FilteredTexture(texture, is_srgb=is_srgb, finest=finest)
        except UserError as error:
            log.info("%s; it counts as white", error)
            textures[id(texture)] = None
    return textures[id(texture)]


def _texels(uv: NDArray, height: int, width: int) -> NDArray[np.float64]:
    """(F,) texels of an image that each face covers."""
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).astype(np.float64) * height * width)


def _mean_around(texture: FilteredTexture, uv: NDArray | None, barycentric: NDArray) -> NDArray[np.float32]:
    """(F, 3) mean of a texture over the piece of each face about a point of it."""
    assert uv is not None
    point = np.einsum("fkc,k->fc", uv.astype(np.float64), barycentric)
    return texture.mean(point, _texels(uv, texture.height, texture.width) / _POINTS**2)


def effects_left_out(parts: Sequence[MeshPart], metallic: Sequence[float]) -> tuple[LeftOut, ...]:
    """What of the materials of a mesh file is not simulated."""
    areas = np.array([_area(part) for part in parts])
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
    return tuple(rows)


def _area(part: MeshPart) -> float:
    corner = part.positions[part.faces]
    return float(np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum())


def _listed(names: Iterable[str], most: int = 3) -> str:
    """A few materials by name, more by number."""
    names = [name for name in names if name]
    shown = ", ".join(f"'{name}'" for name in names[:most])
    if len(names) > most:
        return f"{len(names)} materials ({shown}, …)"
    return f"material {shown}" if len(names) == 1 else f"materials {shown}" if names else "a material without a name"
