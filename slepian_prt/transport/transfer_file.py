"""Transfer as it was traced, in a NumPy ``.npz`` file: to keep, or to read with other tools.

``numpy.load`` shows its arrays by name: ``vectors``, ``positions``, ``normals``, ``faces``, ``albedo``; ``axes`` where
they are not the normals; those of the scene's own light if it has one, and of its lamps (``fixed_direct`` and
``fixed_bounced``, (lamps, V, 3), and what they were set to); ``film_…`` where the receivers are the pixels of a camera;
and ``about``, which is all else as JSON.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from dataclasses import astuple
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output, check_readable, check_writable
from slepian_prt.lighting.emitters import SkyEnvironment
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.lighting.sky import Disk, SkyQuadrature, Sun
from slepian_prt.scene.film import Film
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.transport.archive_members import members_of, open_archive, read_array, read_text
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.json_text import effect_as_json, finite_only, finite_or_none, view_as_json, write_json
from slepian_prt.transport.transfer import Transfer
from slepian_prt.transport.transfer_about import FORMAT, NAMES, VERSION, Shapes, begin_of, check_parts, read_about
from slepian_prt.transport.transport_text import read_transport

# What is told of transfer is no longer in bytes, and only so many times longer than it is packed, but for short ones.
_LONGEST, _SHORT, _RATIO = 1 << 28, 1 << 22, 32

_PLAIN = ("bandlimit", "samples", "seed", "bounces", "rays_traced", "seconds", "source", "toward_view")
_FIXED = ("emitted", "direct", "bounced", "directions")
_DISK = ("directions", "evaluated", "solid_angles")
_FILM = ("background", "directions", "noise", "noise_power")
_FILM_PLAIN = ("name", "width", "height", "crop", "size")


def save_transfer(transfer: Transfer, path: str | Path) -> None:
    """Write an ``.npz`` file: complete or not at all.

    Raises
    ------
    UserError
        Another suffix, a folder that is missing or not writable, or a full disk.
    """
    check_writable(path)
    if Path(path).suffix.lower() != ".npz":
        raise UserError(
            f"{path}: transfer that is not compressed is kept as .npz; name the file so, or compress it first for .prt"
        )
    mesh, light = transfer.mesh, transfer.environment
    about: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        **{name: getattr(transfer, name) for name in _PLAIN},
        "seconds": finite_only(transfer.seconds),
        "parameters": dict(transfer.parameters),
        "name": mesh.name,
        "notes": mesh.notes,
        "known_albedo": mesh.known_albedo,
        "not_simulated": mesh.not_simulated,
        "parts": [list(astuple(part)) for part in transfer.parts],
        "effects": [effect_as_json(effect) for effect in transfer.effects],
        "view": None if transfer.view is None else view_as_json(transfer.view),
        "environment": None if light is None else {"name": light.name, "clamped": light.clamped},
        "noise": finite_or_none(transfer.noise),
    }
    arrays: dict[str, NDArray] = {
        "vectors": transfer.vectors,
        "positions": mesh.positions,
        "normals": mesh.normals,
        "faces": mesh.faces,
        "albedo": mesh.albedo,
    }
    if transfer.axes is not mesh.normals:  # normals are coded in fewer bytes by `compress`, if it is they
        arrays["axes"] = transfer.axes
    if light is not None:
        arrays |= _light_arrays(light)
    if transfer.fixed is not None:
        about["fixed"] = {"names": transfer.fixed.names, "kinds": transfer.fixed.kinds}
        arrays |= {f"fixed_{name}": getattr(transfer.fixed, name) for name in _FIXED}
    if transfer.film is not None:
        about["film"] = {name: getattr(transfer.film, name) for name in _FILM_PLAIN}
        arrays |= {f"film_{name}": getattr(transfer.film, name) for name in _FILM}
    arrays["about"] = _told(path, about, arrays)
    with atomic_output(path) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # of its keyword allow_pickle


def _told(path: str | Path, about: dict[str, Any], arrays: dict[str, NDArray]) -> NDArray:
    """``about`` as a file holds it; raises UserError where `load_transfer` would refuse it or the arrays."""
    try:
        text = write_json(about)
        shapes = Shapes(read_about(text))
        for name in NAMES:
            if name in arrays:
                shapes.expect(name, arrays[name].dtype, arrays[name].shape)
                shapes.accept(name, arrays[name])
        if "film" not in about:
            check_parts(about["parts"], arrays["faces"])
    except ValueError as error:
        reason = shorten(str(error), 200)
        raise UserError(f"{path}: no file can hold this transfer ({reason}); change that before it is saved") from None
    return np.array(text)


def load_transfer(path: str | Path, mesh: str | Path | Mesh | None = None) -> Transfer:
    """Read what `Transfer.save` wrote, or GAMES202's ``transport.txt``.

    Parameters
    ----------
    path : path
        ``.npz``, or ``.txt``.
    mesh : path of an .obj file or Mesh, optional
        Whose triangles a ``.txt`` is of, in their order; it holds none.

    Raises
    ------
    UserError
        Missing, foreign, cut short, damaged, from another version, or of another mesh.
    """
    path = Path(path)
    if path.suffix.lower() == ".txt":
        if mesh is None:
            raise UserError(f"{path}: holds no mesh; give mesh, the one that it was made of")
        return read_transport(path, mesh)
    if mesh is not None:
        raise UserError(f"{path}: holds its mesh; leave out mesh, which is for transport.txt of GAMES202")
    check_readable(path)
    try:
        if not zipfile.is_zipfile(path):
            raise UserError(f"{path}: is no file of Transfer.save; sp.load reads .prt files, sp.precompute traces")
        with open_archive(path) as archive:
            return _transfer(*_read(archive, path))
    except UserError:
        raise
    except (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, KeyError, ValueError, EOFError) as error:
        reason = shorten(" ".join(str(error).split()).strip("'\""), 200) or type(error).__name__
        raise UserError(f"{path}: is no file of Transfer.save, or is cut short or damaged ({reason})") from None
    except MemoryError:
        raise UserError(f"{path}: needs more memory than there is; trace fewer vertices or a lower bandlimit") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None


def _read(archive: zipfile.ZipFile, path: Path) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """What is told of transfer, and its arrays: no more is read than these sizes allow."""
    members = members_of(archive)
    if "about.npy" not in members:
        raise UserError(f"{path}: is no file of Transfer.save; sp.load reads .prt files, sp.precompute traces")
    text = read_text(archive, members["about.npy"], min(_LONGEST, _SHORT + _RATIO * members["about.npy"].compress_size))
    form, version = begin_of(text)
    if form != FORMAT:
        raise UserError(f"{path}: is no file of Transfer.save; sp.load reads .prt files, sp.precompute traces")
    if version != VERSION:
        raise UserError(f"{path}: has format version {shorten(str(version), 20)}, this program reads {VERSION}")
    about = read_about(text)
    shapes, arrays = Shapes(about), {}
    for name in NAMES:
        if f"{name}.npy" in members:
            arrays[name] = read_array(archive, members[f"{name}.npy"], partial(shapes.expect, name))
            shapes.accept(name, arrays[name])
    if "film" not in about and "faces" in arrays:
        check_parts(about["parts"], arrays["faces"])
    return about, arrays


def _transfer(about: dict[str, Any], arrays: dict[str, NDArray]) -> Transfer:
    mesh = Mesh(
        about["name"],
        arrays["positions"],
        arrays["normals"],
        arrays["faces"],
        arrays["albedo"],
        tuple(about["notes"]),
        about["known_albedo"],
        tuple(LeftOut(*row) for row in about["not_simulated"]),
    )
    light = about["environment"]
    return Transfer(
        vectors=arrays["vectors"],
        axes=arrays.get("axes", mesh.normals),
        mesh=mesh,
        parts=tuple(Part(*part) for part in about["parts"]),
        effects=tuple(Effect(**effect) for effect in about["effects"]),
        environment=None if light is None else _light(light["name"], light["clamped"], arrays),
        view=None if about["view"] is None else View(**about["view"]),
        fixed=_fixed(about["fixed"], arrays) if "fixed" in about else None,
        film=_film(about["film"], arrays) if "film" in about else None,
        parameters=about.get("parameters", {}),
        noise=about.get("noise"),
        **{name: about[name] for name in _PLAIN},
    )


def _fixed(lamps: dict[str, Any], arrays: dict[str, NDArray]) -> FixedLights:
    """Light of lamps."""
    emitted, direct, bounced, directions = (arrays[f"fixed_{name}"] for name in _FIXED)
    return FixedLights(tuple(lamps["names"]), tuple(lamps["kinds"]), emitted, direct, bounced, directions)


def _film(about: dict[str, Any], arrays: dict[str, NDArray]) -> Film:
    """Pixels of a camera."""
    known: dict[str, Any] = {name: arrays[f"film_{name}"] for name in _FILM}
    return Film(**{**about, "crop": tuple(about["crop"]), "size": tuple(about["size"])}, **known)


# --- The scene's own light -------------------------------------------------------------------------------------------


def _light_arrays(light: Environment) -> dict[str, NDArray]:
    arrays: dict[str, NDArray] = {"environment_texels": light.texels, "environment_to_world": light.to_world}
    if isinstance(light, SkyEnvironment):
        quadrature, sun = light.quadrature, light.quadrature.sun
        arrays["sky_samples"], arrays["sky_frame"] = light.samples, quadrature.frame
        arrays |= {f"sky_disk_{part}": getattr(quadrature.disk, part) for part in _DISK}
        if sun is not None:
            arrays["sky_sun"] = np.append(sun.direction, sun.depth)
    return arrays


def _light(name: str, clamped: int, arrays: dict[str, NDArray]) -> Environment:
    """As it was, but that a sky is no longer tied to its emitter in a Mitsuba scene."""
    texels, to_world = arrays["environment_texels"], arrays["environment_to_world"]
    if "sky_samples" not in arrays:
        return Environment(name, texels, to_world, clamped)
    sun = Sun(arrays["sky_sun"][:3], float(arrays["sky_sun"][3])) if "sky_sun" in arrays else None
    disk = Disk(*(arrays[f"sky_disk_{part}"] for part in _DISK))
    quadrature, samples = SkyQuadrature(arrays["sky_frame"], sun, disk), arrays["sky_samples"]
    if len(samples) != len(quadrature.directions):
        raise ValueError("the sky is of another version")
    return SkyEnvironment(name, texels, to_world, clamped, quadrature=quadrature, samples=samples, emitter=None)
