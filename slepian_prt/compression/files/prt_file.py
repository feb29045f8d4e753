"""The ``.prt`` file: compressed transfer as a manifest and arrays, and back; docs/file-format.md describes it."""

from __future__ import annotations

import os
from dataclasses import astuple
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slepian_prt.compression.clustering import typical_half_angle
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files import container
from slepian_prt.compression.files.file_size import remember_size
from slepian_prt.compression.files.film_packing import pack_film
from slepian_prt.compression.files.lamp_packing import pack_lamps
from slepian_prt.compression.files.stored_transfer import check_arrays, stored_transfer
from slepian_prt.compression.files.transfer_arrays import pack_transfer
from slepian_prt.compression.files.vertex_order import in_file_order
from slepian_prt.compression.stored_mesh.stored import pack_order
from slepian_prt.errors import UserError
from slepian_prt.transport.json_text import effect_as_json, finite_only, finite_or_none, view_as_json


def save(packed: CompressedTransfer, path: str | Path, *, keep_order: bool = False) -> None:
    """Write a ``.prt`` file: complete or not at all; see `CompressedTransfer.save`.

    Raises
    ------
    UserError
        The folder is missing or not writable, the disk is full, or there is something in it that no file can hold.
    """
    remember_size(packed, container.write(path, *content_of(packed, keep_order=keep_order)))


def content_of(packed: CompressedTransfer, *, keep_order: bool = False) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """The manifest and the arrays of a file."""
    from importlib.metadata import version  # only here: it takes as long to import as a small file to read

    stored, packed = packed.stored, in_file_order(packed)
    manifest: dict[str, Any] = {
        "bandlimit": packed.bandlimit,
        "channels": packed.channels,
        "bounces": packed.bounces,
        "basis": packed.basis,
        "coding": packed.coding,
        "step": 0.0 if packed.coded is None else packed.coded.tuning.step,
        "terms": packed.terms,
        "prior": packed.prior,
        "parts": [list(astuple(part)) for part in packed.parts],
        "caps": len(packed.bases),
        "half_angle": typical_half_angle(packed.clusters, packed.mesh.receivers.active),
        "name": packed.mesh.name,
        "notes": list(packed.mesh.notes),
        "expected_lost": packed.expected.lost.tolist(),
        "expected_total": packed.expected.total.tolist(),
        "effects": [effect_as_json(effect) for effect in packed.effects],
        "samples": packed.samples,
        "seed": packed.seed,
        "rays_traced": packed.rays_traced,
        # The same work gives the same file where builds are to be reproducible (reproducible-builds.org).
        "seconds": {} if "SOURCE_DATE_EPOCH" in os.environ else finite_only(packed.seconds),
        "source": packed.source,
        "parameters": dict(packed.parameters),
        "view": None if packed.view is None else view_as_json(packed.view),
        "toward_view": packed.toward_view,
        "verified": finite_only(packed.verified),  # over black it is no number
        "verified_vertices": packed.verified_vertices,
        "verified_left_out": packed.verified_left_out,
        "written_by": f"slepian_prt {version('slepian_prt')}",
    }
    if packed.film is not None:
        manifest["film"], mesh = pack_film(packed.film, packed.mesh)
    else:
        assert stored is not None
        manifest["mesh"], mesh = stored.entry, dict(stored.arrays)
        if keep_order:
            mesh |= pack_order(stored.order, packed.mesh)
    light: dict[str, NDArray] = {} if packed.lighting is None else {"environment/lighting": packed.lighting}
    if packed.fixed is not None:
        manifest["fixed"], lamps = pack_lamps(packed.fixed)
        light |= lamps
    if finite_or_none(packed.path_noise) is not None:
        manifest["noise"] = packed.path_noise
    return manifest, {**mesh, **light, **pack_transfer(packed)}


def load(path: str | Path, *, check: bool = True) -> CompressedTransfer:
    """Read a ``.prt`` file; what is in it is decoded when it is needed.

    Parameters
    ----------
    path : path
    check : bool
        Whether all of the file is read, its checksums verified and its arrays held against its manifest now, instead of
        when they are needed.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, or from another version.
    """
    if Path(path).suffix.lower() == ".txt":
        _refuse_transport(path)
    contents = container.Contents(path)
    if check:
        check_arrays(contents)
    packed = stored_transfer(contents)
    remember_size(packed, contents.sizes)
    return packed


def _refuse_transport(path: str | Path) -> None:
    """Raise UserError for a transport.txt, which is transfer too, and needs its mesh."""
    from slepian_prt.transport.transport_text import is_transport_text  # only here: few files are such

    if is_transport_text(path):
        raise UserError(
            f"{path}: is a transport.txt of GAMES202, without its mesh; make a transfer file of both in Python: "
            f"sp.compress(sp.load_transfer({str(path)!r}, mesh='NAME.obj'), tolerance=0.02).save('NAME.prt')"
        )
