"""The bytes of vertices as an image, for importers that keep texture coordinates and no other attributes.

Three bytes go to each texel, and none to its alpha: browsers multiply colours by alpha and divide again, and engines
bleed colours into what is transparent. The first texel of a vertex is where its texture coordinates are, and the others
are to the right of it.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError

# Texels along a row, which every graphics hardware takes, and rows that most of it takes.
_WIDTH, _LARGEST = 4096, 16384


def texels_of(functions: int) -> int:
    """Texels of a vertex of so many bytes."""
    return -(-functions // 3)


def byte_texture(vertices: NDArray[np.uint8]) -> tuple[bytes, NDArray[np.float32]]:
    """A PNG of the bytes of vertices (V, K), and (V, 2) where the middles of their first texels are, v down.

    The last texel of a vertex is filled up with zeros.

    Raises
    ------
    UserError
        More than a texture holds.
    """
    from PIL import Image

    count, functions = vertices.shape
    texels = texels_of(functions)
    across = min(_WIDTH // texels, count)
    rows = -(-count // across)
    if rows > _LARGEST:
        raise UserError(
            f"{count} vertices of {functions} bytes need a texture of {rows} rows, and {_LARGEST} are what hardware "
            "takes; give fewer `functions`, or `attributes=bytes`"
        )
    content = np.zeros((rows * across, 3 * texels), dtype=np.uint8)
    content[:count, :functions] = vertices
    stream = io.BytesIO()
    Image.fromarray(content.reshape(rows, across * texels, 3)).save(stream, "PNG", compress_level=9)
    row, column = np.divmod(np.arange(count), across)
    middle = np.stack([(column * texels + 0.5) / (across * texels), (row + 0.5) / rows], axis=1)
    return stream.getvalue(), middle.astype(np.float32)
