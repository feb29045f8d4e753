"""Compressed transfer that is in a file: what its manifest tells at once, the rest decoded when it is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.container import Contents
from slepian_prt.compression.film_packing import unpack_film
from slepian_prt.compression.lamp_packing import unpack_lamps
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.stored_mesh.stored import StoredMesh, read_stored, sizes_of_parts, unpack_order
from slepian_prt.compression.transfer_arrays import unpack_transfer
from slepian_prt.compression.vertex_order import in_source_order
from slepian_prt.errors import UserError
from slepian_prt.scene.film import Film, FilmOutline
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.transport.effects import Effect


class _Late:
    """A field that is decoded, with all others like it, when the first of them is asked for."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, transfer: StoredTransfer | None, owner: type) -> Any:
        if transfer is None:
            return self
        vars(transfer).update(_decoded(transfer._contents))
        return vars(transfer)[self._name]


class StoredTransfer(CompressedTransfer):
    """Compressed transfer of a file."""

    _contents: Contents

    mesh = _Late()
    stored = _Late()
    bases = _Late()
    clusters = _Late()
    coefficients = _Late()
    coded = _Late()
    mean = _Late()
    lighting = _Late()
    fixed = _Late()
    film = _Late()

    @property
    def coding(self) -> str:
        return str(self._contents.manifest["coding"])

    @property
    def name(self) -> str:
        return str(self._contents.manifest["name"])

    @property
    def notes(self) -> tuple[str, ...]:
        return tuple(self._contents.manifest["notes"])

    @property
    def vertex_count(self) -> int:
        manifest = self._contents.manifest
        if "film" in manifest:
            return int(manifest["film"]["width"]) * int(manifest["film"]["height"])
        return sum(part.sides * part.count for part in self.parts)

    @property
    def face_count(self) -> int:
        manifest = self._contents.manifest
        if "film" in manifest:
            return 2 * (int(manifest["film"]["width"]) - 1) * (int(manifest["film"]["height"]) - 1)
        return sum(int(piece["sides"]) * int(piece["faces"]) for piece in manifest["mesh"]["pieces"])

    @property
    def cap_count(self) -> int:
        return int(self._contents.manifest["caps"])

    @property
    def lamp_names(self) -> tuple[str, ...]:
        return tuple(lamp["name"] for lamp in self._contents.manifest.get("fixed", ()))

    @property
    def film_outline(self) -> FilmOutline | None:
        entry = self._contents.manifest.get("film")
        if entry is None:
            return None
        power = np.array(entry["noise_power"], dtype=np.float64)
        return FilmOutline(entry["name"], int(entry["width"]), int(entry["height"]), power)

    @property
    def prior_weights(self) -> NDArray[np.float64] | None:
        name = "basis/weights"
        return self._contents.array(name) if name in self._contents.manifest["arrays"] else None


def stored_transfer(contents: Contents) -> CompressedTransfer:
    """The transfer of a file.

    Raises
    ------
    UserError
        Its manifest is not that of a transfer file.
    """
    transfer = object.__new__(StoredTransfer)
    with _told(contents):
        vars(transfer).update(_fields_of_manifest(contents.manifest), _contents=contents)
        # What else `info` tells.
        for name in (
            "coding",
            "name",
            "notes",
            "vertex_count",
            "face_count",
            "cap_count",
            "lamp_names",
            "film_outline",
        ):
            getattr(transfer, name)
    return transfer


@contextmanager
def _told(contents: Contents) -> Iterator[None]:
    """What does not fit together, said in one line."""
    try:
        yield
    except (KeyError, ValueError, IndexError, TypeError, AttributeError, AssertionError) as error:
        raise UserError(f"{contents.path}: its contents do not fit together ({error!r}); precompute it again") from None


def _fields_of_manifest(manifest: dict[str, Any]) -> dict[str, Any]:
    return {
        "parts": tuple(Part(*part) for part in manifest["parts"]),
        "bandlimit": int(manifest["bandlimit"]),
        "channels": int(manifest["channels"]),
        "basis": manifest["basis"],
        "terms": float(manifest["terms"]),
        "prior": manifest["prior"],
        "expected": Expectation(np.array(manifest["expected_lost"]), np.array(manifest["expected_total"])),
        "effects": tuple(Effect(**effect) for effect in manifest["effects"]),
        "bounces": int(manifest["bounces"]),
        "samples": int(manifest["samples"]),
        "seed": int(manifest["seed"]),
        "rays_traced": int(manifest["rays_traced"]),
        "path_noise": manifest.get("noise"),
        "seconds": dict(manifest["seconds"]),
        "source": manifest["source"],
        "parameters": dict(manifest.get("parameters", {})),
        "view": None if manifest["view"] is None else View(**manifest["view"]),
        "toward_view": bool(manifest["toward_view"]),
        "verified": dict(manifest.get("verified", {})),
        "verified_vertices": int(manifest.get("verified_vertices", 0)),
        "verified_left_out": dict(manifest.get("verified_left_out", {})),
    }


def _decoded(contents: Contents) -> dict[str, Any]:
    """The fields that are not in the manifest."""
    manifest, arrays = contents.manifest, contents.arrays()
    with _told(contents):
        film, mesh, stored = _film_and_mesh(manifest, arrays)
        late = {
            **unpack_transfer(manifest, arrays, mesh),
            "mesh": mesh,
            "stored": stored,
            "film": film,
            "lighting": arrays.get("environment/lighting"),
            "fixed": unpack_lamps(manifest.get("fixed"), arrays, len(mesh.positions)),
        }
        if "mesh/order" not in arrays:
            return late
        fields = _fields_of_manifest(manifest)
        ordered = in_source_order(CompressedTransfer(**fields, **late), unpack_order(arrays["mesh/order"]))
        return {name: getattr(ordered, name) for name in late}


def _film_and_mesh(manifest: dict[str, Any], arrays: dict[str, NDArray]) -> tuple[Film | None, Mesh, StoredMesh | None]:
    name, notes = manifest["name"], tuple(manifest["notes"])
    if "film" in manifest:
        return *unpack_film(manifest["film"], arrays, name, notes), None
    stored = read_stored(manifest["mesh"], arrays, name, notes)
    if sizes_of_parts(stored.entry) != [(part[2], part[3]) for part in manifest["parts"]]:
        raise ValueError("parts of the mesh")
    return None, stored.mesh, stored
