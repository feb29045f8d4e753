"""Compressed transfer that is in a file: what its manifest tells at once, the rest decoded when it is needed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer, Outline
from slepian_prt.compression.files.coded_packing import unpack_coded
from slepian_prt.compression.files.container import Contents
from slepian_prt.compression.files.film_packing import unpack_film
from slepian_prt.compression.files.known import faces_of, vertices_of
from slepian_prt.compression.files.lamp_packing import unpack_lamps
from slepian_prt.compression.files.transfer_arrays import unpack_transfer
from slepian_prt.compression.files.vertex_order import in_source_order
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.stored_mesh.stored import StoredMesh, read_stored, unpack_order
from slepian_prt.errors import UserError
from slepian_prt.machine.kept import Kept
from slepian_prt.machine.memory import check_memory
from slepian_prt.scene.film import Film, FilmOutline
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.transport.effects import Effect

# Bytes that the mesh takes meanwhile, and what lamps send: measured on models of 87,000 vertices.
_OF_VERTEX, _OF_FACE, _OF_LAMP = 500, 250, 24


class _Late:
    """A field that is decoded, with all others like it, when the first of them is asked for."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, transfer: StoredTransfer | None, owner: type) -> Any:
        if transfer is None:
            return self

        def decode() -> dict[str, Any]:
            if self._name not in vars(transfer):  # by a thread that was waited for
                vars(transfer).update(_decoded(transfer._contents))
            return vars(transfer)

        found = _late.of(transfer, decode)[self._name]
        _late.forget(transfer)
        return found


# Fields of transfers that some thread decodes now, so that others wait for it.
_late: Kept[CompressedTransfer, dict[str, Any]] = Kept()


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


def check_arrays(contents: Contents) -> None:
    """Raise UserError for a file whose arrays do not fit its manifest; nothing is decoded."""
    arrays = contents.arrays()
    if contents.manifest["coding"] == "coded":
        with _told(contents):
            unpack_coded(arrays, contents.manifest["step"], contents.manifest["caps"])


def stored_transfer(contents: Contents) -> CompressedTransfer:
    """The transfer of a file.

    Raises
    ------
    UserError
        Its manifest is not that of a transfer file.
    """
    transfer = object.__new__(StoredTransfer)
    fields = _fields_of_manifest(contents.manifest)
    vars(transfer).update(fields, _contents=contents, _outline=_outline(contents))
    return transfer


@contextmanager
def _told(contents: Contents) -> Iterator[None]:
    """What does not fit together, said in one line."""
    try:
        yield
    except UserError:
        raise
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise UserError(f"{contents.path}: its contents do not fit together ({error}); precompute it again") from None
    except MemoryError:
        raise UserError(f"{contents.path}: needs more memory than there is; precompute it again, coarser") from None


def _fields_of_manifest(manifest: dict[str, Any]) -> dict[str, Any]:
    return {
        "parts": tuple(Part(*part) for part in manifest["parts"]),
        "bandlimit": manifest["bandlimit"],
        "channels": manifest["channels"],
        "basis": manifest["basis"],
        "terms": manifest["terms"],
        "prior": manifest["prior"],
        "expected": Expectation(np.array(manifest["expected_lost"]), np.array(manifest["expected_total"])),
        "effects": tuple(Effect(**effect) for effect in manifest["effects"]),
        "bounces": manifest["bounces"],
        "samples": manifest["samples"],
        "seed": manifest["seed"],
        "rays_traced": manifest["rays_traced"],
        "path_noise": manifest.get("noise"),
        "seconds": dict(manifest["seconds"]),
        "source": manifest["source"],
        "parameters": dict(manifest.get("parameters", {})),
        "view": None if manifest["view"] is None else View(**manifest["view"]),
        "toward_view": manifest["toward_view"],
        "verified": dict(manifest.get("verified", {})),
        "verified_vertices": manifest.get("verified_vertices", 0),
        "verified_left_out": dict(manifest.get("verified_left_out", {})),
    }


def _outline(contents: Contents) -> Outline:
    manifest, film = contents.manifest, None
    if "film" in manifest:
        entry = manifest["film"]
        power = np.array(entry["noise_power"], dtype=np.float64)
        film = FilmOutline(entry["name"], entry["width"], entry["height"], power)
    return Outline(
        name=manifest["name"],
        notes=tuple(manifest["notes"]),
        vertices=vertices_of(manifest),
        faces=faces_of(manifest),
        caps=manifest["caps"],
        coding=manifest["coding"],
        prior_weights=contents.array("basis/weights") if "basis/weights" in manifest["arrays"] else None,
        lamps=tuple(lamp["name"] for lamp in manifest.get("fixed", ())),
        film=film,
        half_angle=manifest.get("half_angle"),
    )


def _decoded(contents: Contents) -> dict[str, Any]:
    """The fields that are not in the manifest."""
    manifest = contents.manifest
    lamps = len(manifest.get("fixed", ()))
    need = vertices_of(manifest) * (_OF_VERTEX + _OF_LAMP * lamps) + faces_of(manifest) * _OF_FACE
    check_memory(need, f"{contents.path}", "precompute it again with fewer vertices")
    arrays = contents.arrays()
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
    return None, stored.mesh, stored
