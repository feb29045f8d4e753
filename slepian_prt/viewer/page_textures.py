"""Textures of a page: files that browsers read, of a size that graphics hardware takes."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.textures import encoded_image
from slepian_prt.viewer.buffers import Buffers

# All hardware with WebGL2 takes this many texels a side. A file that is larger is written again as JPEG.
_LARGEST_SIDE = 4096
_LARGEST_FILE = 4_000_000
_QUALITY = 92


def texture_entry(buffers: Buffers, texture: Texture) -> dict[str, Any]:
    """What the payload says of a texture, which is that of its file where it is not too large."""
    content, suffix = _small(*encoded_image(texture))
    return {
        "bytes": buffers.add(np.frombuffer(content, dtype=np.uint8)),
        "mime": "image/png" if suffix == ".png" else "image/jpeg",
        "wrap": list(texture.wrap),
    }


def _small(content: bytes, suffix: str) -> tuple[bytes, str]:
    from PIL import Image  # only for textures

    with Image.open(io.BytesIO(content)) as image:
        if max(image.size) <= _LARGEST_SIDE and len(content) <= _LARGEST_FILE:
            return content, suffix
        small = image.convert("RGB")
        small.thumbnail((_LARGEST_SIDE, _LARGEST_SIDE), Image.Resampling.BOX)
        stream = io.BytesIO()
        small.save(stream, "JPEG", quality=_QUALITY, subsampling=0)
    return stream.getvalue(), ".jpg"
