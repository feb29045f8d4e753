"""Lights of a page: coefficients, and maps small enough to carry, for what is behind the model."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import Environment, check_names, read_environment
from slepian_prt.lighting.formats.exr_header import read_headers
from slepian_prt.lighting.projection import project_checked, project_environment
from slepian_prt.scene.reflectance.textures import area_weights
from slepian_prt.scene.view import up_rotation
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.viewer.buffers import Buffers

# A map file that is carried as it is, and the size of one that is made smaller.
_LARGEST_FILE = 600_000
_LARGEST_WIDTH = 1024

# What a half float holds, and how coarsely DWAA rounds: 10 changes texels by 0.1 %, a hundredth of them by 1 %.
_LARGEST_HALF = 65504.0
_DWA_LEVEL = 10.0


@dataclass(frozen=True, eq=False)
class PageLight:
    """A distant light.

    Attributes
    ----------
    name : str
    coefficients : (3, (L+1)²) float64
        As it stands.
    map : bytes
        A file that browsers can read; empty if there is no map.
    suffix : str
        Of that file: ``.exr`` or ``.hdr``.
    to_world : (3, 3)
        How the map stands.
    clamped : int
        Texels that were negative.
    own : bool
        Whether it is the light of the scene, which has no map.
    """

    name: str
    coefficients: NDArray[np.float64]
    map: bytes
    suffix: str
    to_world: NDArray[np.float64]
    clamped: int = 0
    own: bool = False

    def entry(self, buffers: Buffers) -> dict[str, Any]:
        """What the payload says of it."""
        return {
            "name": self.name,
            "coefficients": buffers.add(self.coefficients.ravel()),
            "map": buffers.add(np.frombuffer(self.map, dtype=np.uint8)) if self.map else None,
            "suffix": self.suffix or None,
            "to_world": self.to_world.tolist(),
            "clamped": self.clamped,
            "own": self.own,
        }


def map_lights(
    maps: Sequence[str | Path | Environment], bandlimit: int, up: str, *, clamp_negative: bool
) -> tuple[PageLight, ...]:
    """Maps as lights, where ``up`` is up; coefficients are those of all their texels.

    Raises
    ------
    UserError
        A map that cannot be used; two of the same name.
    """
    check_names([one.name if isinstance(one, Environment) else one for one in maps])
    stand = up_rotation(up)
    return tuple(_map_light(one, bandlimit, stand, clamp_negative) for one in maps)


def own_light(packed: Sequence[CompressedTransfer]) -> PageLight:
    """The light that the scene has of its own, as the file with most degrees has it; dark where lamps are all of it.

    Raises
    ------
    UserError
        It has neither.
    """
    size = max(num_coefficients(one.bandlimit) for one in packed)
    known = [one.lighting for one in packed if one.lighting is not None]
    if not known and all(one.fixed is None for one in packed):
        raise UserError("the scene has no light of its own; name a map with `environment`")
    coefficients = np.zeros((3, size))
    if known:
        most = max(known, key=lambda lighting: lighting.shape[1])
        coefficients[:, : most.shape[1]] = most
    name = "light of the scene" if known else "lamps of the scene"
    return PageLight(name, coefficients, b"", "", np.eye(3), own=True)


def _map_light(given: str | Path | Environment, bandlimit: int, stand: NDArray, clamp_negative: bool) -> PageLight:
    if isinstance(given, Environment):
        coefficients = project_environment(given, bandlimit, rotate=stand)
        content = _small_exr(given.texels)
        return PageLight(given.name, coefficients, content, ".exr", stand @ given.to_world, given.clamped)
    path = Path(given)
    coefficients, clamped = project_checked(path, bandlimit, rotate=stand, clamp_negative=clamp_negative)
    if not clamped and (suffix := _plain_suffix(path)):
        return PageLight(path.stem, coefficients, path.read_bytes(), suffix, stand)
    texels = read_environment(path, clamp_negative=clamp_negative).texels
    return PageLight(path.stem, coefficients, _small_exr(texels), ".exr", stand, clamped)


def _plain_suffix(path: Path) -> str:
    """The suffix of a small file that means without its header what it means with it; else empty."""
    if path.stat().st_size > _LARGEST_FILE:
        return ""
    start = path.read_bytes()[:4096]
    if start.startswith(b"\x76\x2f\x31\x01"):
        parts = read_headers(path)
        names = [channel.name for channel in parts[0].channels]
        plain = len(parts) == 1 and sorted(names) == ["B", "G", "R"] and parts[0].chromaticities is None
        plain &= parts[0].data == parts[0].display and not parts[0].tiled and not parts[0].deep
        plain &= parts[0].data.left == parts[0].data.top == 0
        plain &= {(channel.kind, channel.sampling) for channel in parts[0].channels} <= _PLAIN_CHANNELS
        return ".exr" if plain else ""
    if start.startswith(b"#?"):
        header = start.partition(b"\n\n")[0].splitlines()[1:]
        plain = all(line.startswith(b"#") or line == b"FORMAT=32-bit_rle_rgbe" for line in header)
        plain &= b"FORMAT=32-bit_rle_rgbe" in header and start.partition(b"\n\n")[2].startswith(b"-Y ")
        return ".hdr" if plain else ""
    return ""


_PLAIN_CHANNELS = {("half", (1, 1)), ("float", (1, 1))}


def _small_exr(texels: NDArray[np.float32]) -> bytes:
    """An OpenEXR file of half floats, at most `_LARGEST_WIDTH` wide."""
    import OpenEXR

    # OpenEXR does not look at strides.
    small = np.ascontiguousarray(np.clip(_shrunk(texels), 0.0, _LARGEST_HALF), dtype=np.float16)
    header = {
        "compression": OpenEXR.DWAA_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dwaCompressionLevel": _DWA_LEVEL,
    }
    with tempfile.TemporaryDirectory(prefix="slepian_prt-") as folder:
        path = Path(folder) / "map.exr"
        OpenEXR.File(header, {"RGB": small}).write(str(path))
        return path.read_bytes()


def _shrunk(texels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of texels over equal pieces of the map, if it is wider than `_LARGEST_WIDTH`."""
    height, width = texels.shape[:2]
    if width <= _LARGEST_WIDTH:
        return texels
    rows, columns = (
        area_weights(size, wanted) for size, wanted in ((height, _LARGEST_WIDTH // 2), (width, _LARGEST_WIDTH))
    )
    return np.stack([rows @ channel @ columns.T for channel in np.moveaxis(texels, 2, 0)], axis=2)
