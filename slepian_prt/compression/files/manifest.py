"""The manifest of a ``.prt`` file: which keys there are, of what types and in what ranges (docs/file-format.md).

What arrays there have to be besides, and what numbers of both have to do with each other, stands in `array_schema`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from slepian_prt.scene.view import LARGEST_SIDE, MOST_PIXELS, check_view

FORMAT = "slepian_prt transfer"
VERSION = 3

# As of `TransportSettings`, which takes long to import.
LARGEST_BANDLIMIT = 50

# Faces are held in 32 bits.
_MOST = (1 << 31) - 1

# Products of four are still finite, as of meshes that are read.
_LARGEST_COORDINATE = 1e60

# All that is stored of transfer and light is below this, so that sums of products of both are finite in float32.
LARGEST_NUMBER = 2.0**64

_FURTHEST_PLACE = 1 << 52
_FINEST_SHIFT = 36
_MOST_CAPS = 1 << 16  # 4096 clusters of 16 occlusion classes
_TABLE = 256

Text = Annotated[str, Meta(max_length=1 << 16)]
Count = Annotated[int, Meta(ge=0, le=_MOST)]
Whole = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]
Side = Annotated[int, Meta(ge=1, le=LARGEST_SIDE)]
Finite = Annotated[float, Meta(ge=-1e300, le=1e300)]
Power = Annotated[float, Meta(ge=0.0, le=1e100)]
Number = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Coordinate = Annotated[float, Meta(ge=-_LARGEST_COORDINATE, le=_LARGEST_COORDINATE)]
Reflectance = Annotated[float, Meta(ge=0.0, le=2.0**32)]
Place = Annotated[int, Meta(ge=-_FURTHEST_PLACE, le=_FURTHEST_PLACE)]
Degrees = Annotated[list[Power], Meta(min_length=1, max_length=LARGEST_BANDLIMIT + 1)]
Row = Annotated[list[Finite], Meta(min_length=4, max_length=4)]


class Begin(Struct):
    """What tells a manifest of ours, of whatever version."""

    format: Any = None
    version: Any = None


class Piece(Struct):
    """Of a mesh."""

    vertices: Annotated[int, Meta(ge=1, le=_MOST)]
    faces: Count
    sides: Literal[1, 2]
    shift: Annotated[int, Meta(ge=0, le=_FINEST_SHIFT)]
    first: Annotated[list[Place], Meta(min_length=3, max_length=3)]
    draco: Count
    loose: Count
    loose_faces: Count
    landmarks: Annotated[list[list[Count]], Meta(min_length=2, max_length=2)]


class Albedo(Struct):
    """How the albedo of a mesh is stored."""

    kind: Literal["constant", "table", "float16", "float32"]
    colors: Annotated[list[Annotated[list[Reflectance], Meta(min_length=3, max_length=3)]], Meta(min_length=1)] | (
        UnsetType
    ) = UNSET
    values: Annotated[list[Reflectance], Meta(min_length=1, max_length=_TABLE)] | UnsetType = UNSET


class StoredMesh(Struct):
    """How a mesh is stored."""

    low: Annotated[list[Coordinate], Meta(min_length=3, max_length=3)]
    step: Annotated[float, Meta(gt=0.0, le=_LARGEST_COORDINATE)]
    pieces: Annotated[list[Piece], Meta(min_length=1)]
    exact: bool
    albedo: Albedo
    positions: Literal["float32", "float64"] | UnsetType = UNSET


class StoredFilm(Struct):
    """Of a camera whose pixels the vertices are."""

    name: Text
    width: Side
    height: Side
    crop: Annotated[list[Count], Meta(min_length=2, max_length=2)]
    size: Annotated[list[Side], Meta(min_length=2, max_length=2)]
    noise_power: Degrees


class StoredLamp(Struct):
    """Of the scene."""

    name: Text
    kind: Text
    emitted: Annotated[list[Number], Meta(min_length=3, max_length=3)]
    direction: Annotated[list[Annotated[float, Meta(ge=-1.001, le=1.001)]], Meta(min_length=3, max_length=3)]
    direct_rows: Literal[0, 1, 3]
    bounced_rows: Literal[0, 1, 3]


class StoredPart(Struct, array_like=True):
    """A shape of the scene."""

    name: Text
    first: Count
    count: Annotated[int, Meta(ge=1, le=_MOST)]
    sides: Literal[1, 2] = 1


class StoredEffect(Struct):
    """A row of the plan."""

    name: Text
    verdict: Text
    contribution: Finite | None
    confidence: Finite | None
    rays: Whole
    reason: Text


class StoredView(Struct):
    """The camera of the scene."""

    name: Text
    to_world: Annotated[list[Row], Meta(min_length=4, max_length=4)]
    fov: Annotated[float, Meta(gt=0.0, lt=180.0)]
    width: Side
    height: Side
    near: Finite
    far: Finite


class Manifest(Struct):
    """All of it; other keys are passed over."""

    format: Literal["slepian_prt transfer"]
    version: Literal[3]
    arrays: Annotated[list[Text], Meta(max_length=1 << 10)]
    bandlimit: Annotated[int, Meta(ge=0, le=LARGEST_BANDLIMIT)]
    channels: Literal[1, 3]
    coding: Literal["coded", "float16", "float32"]
    step: Annotated[float, Meta(ge=0.0, le=LARGEST_NUMBER)]
    caps: Annotated[int, Meta(ge=1, le=_MOST_CAPS)]
    basis: Text
    terms: Annotated[float, Meta(ge=0.0, le=1 << 16)]
    prior: Text
    bounces: Whole
    samples: Whole
    seed: Annotated[int, Meta(ge=0)]
    rays_traced: Whole
    name: Text
    source: Text
    parts: list[StoredPart]
    notes: list[Text]
    expected_lost: Annotated[list[Finite], Meta(min_length=1, max_length=LARGEST_BANDLIMIT + 1)]
    expected_total: Degrees
    effects: list[StoredEffect]
    seconds: dict[Text, Finite]
    view: StoredView | None
    toward_view: bool
    half_angle: Annotated[float, Meta(ge=0.0, le=math.pi)] | UnsetType = UNSET
    parameters: dict[Text, Text] | UnsetType = UNSET
    verified: dict[Text, Finite] | UnsetType = UNSET
    verified_vertices: Count | UnsetType = UNSET
    verified_left_out: dict[Text, dict[Text, Count]] | UnsetType = UNSET
    noise: Annotated[float, Meta(ge=0.0, le=1e100)] | UnsetType | None = UNSET
    mesh: StoredMesh | UnsetType = UNSET
    film: StoredFilm | UnsetType = UNSET
    fixed: list[StoredLamp] | UnsetType = UNSET
    written_by: Text | UnsetType = UNSET


# Made once: it takes as long as to read some manifests.
_begin, _manifest = msgspec.json.Decoder(Begin), msgspec.json.Decoder(Manifest)


def begin_of(content: bytes) -> tuple[Any, Any]:
    """Format and version that a manifest names, whatever else there is in it.

    Raises
    ------
    ValueError
        Not JSON, or no object.
    """
    try:
        begin = _begin.decode(content)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(_line(error)) from None
    return begin.format, begin.version


def read_manifest(content: bytes) -> dict[str, Any]:
    """A manifest as plain data, checked: its keys and their types and ranges, and the relations among them.

    Raises
    ------
    ValueError
        Says in which key what is wrong.
    """
    try:
        manifest = _manifest.decode(content)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(_line(error)) from None
    _relate(manifest)
    plain: dict[str, Any] = msgspec.to_builtins(manifest)
    return plain


def _line(error: Exception) -> str:
    """Without quotation marks that mean options elsewhere."""
    text = " ".join(str(error).replace("`", "").split())
    return text if text.isascii() and text.isprintable() else type(error).__name__


def _relate(manifest: Manifest) -> None:
    """Raise ValueError unless the numbers of a manifest belong together."""
    bands = manifest.bandlimit + 1
    for name in ("expected_lost", "expected_total"):
        if len(getattr(manifest, name)) != bands:
            raise ValueError(f"{name} has {len(getattr(manifest, name))} degrees of bandlimit {manifest.bandlimit}")
    if min(manifest.expected_lost) < -1e-6 * sum(manifest.expected_total):  # but for rounding
        raise ValueError("expected_lost is negative")
    if manifest.view is not None:
        check_view(manifest.view)
    if len(set(manifest.arrays)) != len(manifest.arrays):
        raise ValueError("an array is named twice")
    if manifest.coding == "coded" and manifest.step <= 0.0:
        raise ValueError("step is 0")
    if manifest.terms > bands * bands + 1:  # with a mean, which counts as one
        raise ValueError(f"{manifest.terms} terms of bandlimit {manifest.bandlimit}")
    if (manifest.film is UNSET) == (manifest.mesh is UNSET):
        raise ValueError("it needs either a mesh or a film")
    ends = [0]
    for part in manifest.parts:
        if part.first != ends[-1]:
            raise ValueError("parts do not follow each other")
        ends.append(part.first + part.sides * part.count)
    if ends[-1] > _MOST:
        raise ValueError(f"{ends[-1]} vertices")
    vertices = manifest.film.width * manifest.film.height if isinstance(manifest.film, StoredFilm) else ends[-1]
    if manifest.caps > vertices:  # each held one when it was made
        raise ValueError(f"{manifest.caps} caps of {vertices} vertices")
    if isinstance(manifest.mesh, StoredMesh):
        _relate_mesh(manifest, manifest.mesh)
    if isinstance(manifest.film, StoredFilm):
        film = manifest.film
        if film.width * film.height > MOST_PIXELS or ends[-1] > film.width * film.height:
            raise ValueError(f"a film of {film.width} x {film.height} pixels with parts of {ends[-1]}")
        if len(film.noise_power) != bands:
            raise ValueError("noise_power of the film")


def _relate_mesh(manifest: Manifest, mesh: StoredMesh) -> None:
    if [(piece.vertices, piece.sides) for piece in mesh.pieces] != [
        (part.count, part.sides) for part in manifest.parts
    ]:
        raise ValueError("the pieces of the mesh are not its parts")
    for piece in mesh.pieces:
        before, after = piece.landmarks
        if len(before) != len(after) or max([0, *before, *after]) >= piece.vertices:
            raise ValueError("landmarks of the mesh")
        if piece.loose > piece.vertices or piece.loose_faces > piece.faces:
            raise ValueError("more is loose than there is of a piece")
        if piece.draco == 0 and (piece.loose, piece.loose_faces) != (piece.vertices, piece.faces):
            raise ValueError("a piece without its vertices and faces")
    if sum(piece.sides * piece.faces for piece in mesh.pieces) > _MOST:
        raise ValueError("too many faces")
    if mesh.exact and mesh.positions is UNSET:
        raise ValueError("type of the positions")
    if mesh.albedo.kind == "table" and mesh.albedo.values is UNSET:
        raise ValueError("values of the albedo")
    if mesh.albedo.kind == "constant":
        blocks = sum(piece.sides for piece in mesh.pieces)
        if mesh.albedo.colors is UNSET or len(mesh.albedo.colors) not in (1, blocks):
            raise ValueError("colors of the albedo")
