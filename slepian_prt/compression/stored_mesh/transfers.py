"""Transfer whose vertices are as a file will have them: what compression makes of it, readers make again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slepian_prt.compression.stored_mesh.stored import StoredMesh, store_mesh
from slepian_prt.errors import UserError
from slepian_prt.transport.transfer import Transfer


def stored_mesh_of(transfer: Transfer, *, exact: bool = False) -> StoredMesh | None:
    """The mesh of transfer as files have it, by `store_mesh`; None for the pixels of a film, which have no mesh.

    Raises
    ------
    UserError
        Its parts are not those of its mesh.
    """
    if transfer.film is not None:
        return None
    try:
        return store_mesh(transfer.mesh, transfer.parts, exact=exact)
    except UserError:
        raise
    except ValueError as error:
        raise UserError(f"transfer of {transfer.mesh.name}: {error}; trace it again") from None


def as_stored(transfer: Transfer, *, exact: bool = False) -> Transfer:
    """The same vectors with the mesh that `stored_mesh_of` gives, and with its normals where they are the axes."""
    stored = stored_mesh_of(transfer, exact=exact)
    if stored is None:
        return transfer
    axes = stored.mesh.normals if np.array_equal(transfer.axes, transfer.mesh.normals) else transfer.axes
    return replace(transfer, mesh=stored.mesh, axes=axes)
