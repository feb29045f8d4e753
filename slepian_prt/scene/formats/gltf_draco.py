"""Primitives that are compressed with Draco, through the package DracoPy.

Source: KHR_draco_mesh_compression.
"""

from __future__ import annotations

import importlib

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.draco_header import draco_counts
from slepian_prt.scene.formats.gltf_accessors import read_view
from slepian_prt.scene.formats.gltf_file import Document
from slepian_prt.scene.formats.gltf_json import Entry

# Bytes that Draco takes meanwhile, and more.
_OF_FACE, _OF_VERTEX = 120, 200

EXTENSION = "KHR_draco_mesh_compression"


def decode_draco(document: Document, primitive: Entry) -> dict[str, NDArray]:
    """Attributes of a compressed primitive by name, and its ``faces`` (F, 3); empty if it is not compressed.

    Raises
    ------
    UserError
        It cannot be decoded.
    """
    extension = primitive.extension(EXTENSION)
    if extension is None:
        return {}
    data = read_view(document, extension.integer("bufferView"), extension).tobytes()
    names = extension.entry("attributes")
    if names is None:
        raise extension.fault("has no attributes")
    try:
        told = draco_counts(data)
    except ValueError as error:
        raise extension.fault(f"cannot be decoded: {error}") from None
    document.take(_OF_FACE * told[0] + _OF_VERTEX * told[1])
    package = importlib.import_module("DracoPy")
    try:
        mesh = package.decode(data)
        found = {int(attribute["unique_id"]): np.asarray(attribute["data"]) for attribute in mesh.attributes}
        faces = np.asarray(mesh.faces)
    except Exception as error:  # DracoPy raises Exception itself
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
