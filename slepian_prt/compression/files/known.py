"""What is known of a file while its arrays are read one after the other."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import num_coefficients

# Pairs of vertices of a source, and here: vertices at one place may be joined, up to so many for each corner of a face.
_JOINED = 64


@dataclass(frozen=True)
class Known:
    """Sizes by their names, as `array_schema` has them.

    Attributes
    ----------
    manifest : dict
        As `read_manifest` gives it.
    names : collection of str
        Of the arrays in the file.
    sizes : dict of str to int
    ranges : dict of str to (int, int)
        Smallest and largest, of sizes of which more is not known.
    arrays : dict of str to array
        That were read, for what later ones have to do with them.
    """

    manifest: dict[str, Any]
    names: Collection[str]
    sizes: dict[str, int] = field(default_factory=dict)
    ranges: dict[str, tuple[int, int]] = field(default_factory=dict)
    arrays: dict[str, NDArray] = field(default_factory=dict)

    @property
    def mesh(self) -> dict[str, Any] | None:
        """The entry of the mesh."""
        return self.manifest.get("mesh")

    @property
    def film(self) -> dict[str, Any] | None:
        """The entry of the film."""
        return self.manifest.get("film")

    @property
    def terms(self) -> NDArray[np.int64]:
        """(C,) functions of each cap."""
        return np.broadcast_to(self.arrays["caps/terms"].astype(np.int64), self.sizes["C"])


def known_of(manifest: dict[str, Any], names: Collection[str]) -> Known:
    """What the manifest tells."""
    caps, channels, size = manifest["caps"], manifest["channels"], num_coefficients(manifest["bandlimit"])
    vertices, lamps = vertices_of(manifest), manifest.get("fixed", ())
    known = Known(manifest, names)
    known.sizes.update({"V": vertices, "C": caps, "L+1": manifest["bandlimit"] + 1, "M": size, "lamps": len(lamps)})
    known.sizes["C D M"] = caps * channels * size
    known.sizes["stored normals"] = 0  # until ways of normals tell others
    for table in ("direct", "bounced"):
        known.sizes[f"{table} rows"] = sum(lamp[f"{table}_rows"] for lamp in lamps)
    pieces = [] if known.mesh is None else known.mesh["pieces"]
    for name, key in (("draco", "draco"), ("loose", "loose"), ("loose faces", "loose_faces")):
        known.sizes[name] = sum(piece[key] for piece in pieces)
    known.ranges["C or 1"] = (1, caps)
    known.ranges["families"] = (1, caps)
    known.ranges["rows"] = (1, 3)
    known.ranges["bytes"] = (0, 8)
    known.ranges["pairs"] = (vertices, _JOINED * (vertices + faces_of(manifest)))
    return known


def vertices_of(manifest: dict[str, Any]) -> int:
    """V."""
    if "film" in manifest:
        return int(manifest["film"]["width"] * manifest["film"]["height"])
    return sum(count * sides for _, _, count, sides in manifest["parts"])


def faces_of(manifest: dict[str, Any]) -> int:
    """F."""
    if "film" in manifest:
        return 2 * (manifest["film"]["width"] - 1) * (manifest["film"]["height"] - 1)
    return sum(piece["sides"] * piece["faces"] for piece in manifest["mesh"]["pieces"])
