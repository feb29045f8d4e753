"""What a program has to be told to relight an exported model, in ``extras`` of its root."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.relighting.files.gltf_document import GltfDocument
from slepian_prt.runtime.gpu_transfer import GpuTransfer

# The key in ``extras``.
NAME = "slepian_prt"

_HARMONICS = (
    "real spherical harmonics, orthonormal on the sphere, with the Condon-Shortley phase, polar axis z, of the axes "
    "that POSITION has (before the nodes turn it); coefficient l*l + l + m of degree l and order m, m > 0 with cos, "
    "m < 0 with sin; degree 1 is sqrt(3 / (4 pi)) times -y, z, -x"
)
_LIGHT = (
    "coefficients of distant light: the integrals of its radiance, for each colour, times the harmonics, over the "
    "directions that it comes from"
)
_RADIANCE = (
    "with b the numbers of a vertex, c = b[K-1] and table[c][k] = functions[c][k] . light, for each colour (the same "
    "functions for all of them where there is one channel): table[c][0] + sum over k = 1 .. K-1 of (b[k-1] / 255 - "
    "zeros[c][k-1]) * table[c][k], plus _LAMPS where there are any, times the colour of the material, COLOR_0 and the "
    "texture; interpolate radiance over triangles, never b"
)
_LAMPS = "_LAMPS is what white surfaces send back of the scene's lamps, added before the colour of the material"


def describe(document: GltfDocument, packed: CompressedTransfer, gpu: GpuTransfer, carried: dict[str, Any]) -> dict:
    """The functions as buffer views of the document, and all that is to be known of them.

    Parameters
    ----------
    document : GltfDocument
    packed : CompressedTransfer
    gpu : GpuTransfer
    carried : dict
        How the bytes of vertices are.
    """
    lamps = {} if packed.fixed is None else {"lamps": list(packed.fixed.names), "lampsAre": _LAMPS}
    return {
        "version": 1,
        "kind": "transfer",
        "bandlimit": gpu.bandlimit,
        "channels": gpu.channels,
        "caps": gpu.cap_count,
        "bytesPerVertex": gpu.function_count,
        "coefficients": carried,
        # Numbers of float16, so that nothing is lost.
        "functions": _array(document, gpu.functions.astype("<f2"), "cap, function, channel, harmonic"),
        "zeros": _array(document, gpu.zeros.astype("<f4"), "cap, coefficient"),
        "harmonics": _HARMONICS,
        "light": _LIGHT,
        "radiance": _RADIANCE,
        "error": {"ofThis": gpu.error(), "withThatOfTheFile": gpu.relit_error()},
        **lamps,
    }


def _array(document: GltfDocument, values: NDArray, axes: str) -> dict[str, Any]:
    """Numbers in row-major order, little-endian."""
    return {
        "bufferView": document.add_view(values.tobytes()),
        "dtype": values.dtype.name,
        "shape": list(values.shape),
        "axes": axes,
        "layout": "row-major, little-endian",
    }
