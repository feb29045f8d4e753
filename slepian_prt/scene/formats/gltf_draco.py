"""Primitives that are compressed with Draco, through the package DracoPy if it is there.

Source: KHR_draco_mesh_compression.
"""

from __future__ import annotations

import importlib
import importlib.util

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.gltf_accessors import read_view
from slepian_prt.scene.formats.gltf_file import Document
from slepian_prt.scene.formats.gltf_json import Entry

EXTENSION = "KHR_draco_mesh_compression"


def refuse_draco(document: Document) -> UserError:
    """What to raise where nothing here can decode it."""
    return UserError(
        f"{document.path}: is Draco-compressed ({EXTENSION}) and cannot be decoded here; pip install DracoPy, or "
        "export it without compression"
    )


def can_decode_draco() -> bool:
    return importlib.util.find_spec("DracoPy") is not None


def decode_draco(document: Document, primitive: Entry) -> dict[str, NDArray]:
    """Attributes of a compressed primitive by name, and its ``faces`` (F, 3); empty if it is not compressed.

    Raises
    ------
    UserError
        It cannot be decoded here, or not at all.
    """
    extension = primitive.extension(EXTENSION)
    if extension is None:
        return {}
    if not can_decode_draco():
        if _has_fallback(document, primitive):
            return {}
        raise refuse_draco(document)
    data = read_view(document, extension.integer("bufferView"), extension).tobytes()
    names = extension.entry("attributes")
    if names is None:
        raise extension.fault("has no attributes")
    package = importlib.import_module("DracoPy")
    try:
        mesh = package.decode(data)
        found = {int(attribute["unique_id"]): np.asarray(attribute["data"]) for attribute in mesh.attributes}
        faces = np.asarray(mesh.faces)
    except Exception as error:  # DracoPy raises Exception itself, or lacks what older versions lack
        reason = " ".join(str(error).split()) or type(error).__name__
        raise extension.fault(f"cannot be decoded by DracoPy: {reason}") from None
    decoded: dict[str, NDArray] = {}
    for name in names.values:
        identifier = names.integer(name)
        if identifier not in found:
            raise names.fault(f"names attribute {identifier}, which its Draco data do not have")
        values = found[identifier]
        decoded[name] = values.reshape(len(values), -1)
    return {**decoded, "faces": faces.reshape(-1, 3)}


def _has_fallback(document: Document, primitive: Entry) -> bool:
    """Whether the positions of a primitive are there uncompressed, too."""
    attributes = primitive.entry("attributes")
    if attributes is None or "POSITION" not in attributes.values:
        return False
    return "bufferView" in document.find("accessors", attributes, "POSITION").values
