"""A transfer file in a Mitsuba scene: its surfaces, lit, where camera rays meet them."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.prt_file import load
from slepian_prt.errors import UserError
from slepian_prt.relighting.mitsuba.emission import Relit
from slepian_prt.relighting.mitsuba.surfaces import Surfaces
from slepian_prt.scene.materials import diffuse_reflectance, left_out

# Remarked on: mean reflectance of a material below this, where the file knows none; part of negative vertices above.
_ALL_REFLECTED = 0.99
_NEGATIVE = 1e-3


def warn(mi: Any, text: str) -> None:
    """A remark in Mitsuba's log."""
    mi.Log(mi.LogLevel.Warn, f"slepian_prt: {text}")


@lru_cache(maxsize=8)
def _loaded(path: str, _changed: int, _size: int) -> CompressedTransfer:
    return load(path)


def read_once(path: str) -> CompressedTransfer:
    """A file, read once however many integrators and variants use it."""
    if not os.path.isfile(path):
        return load(path)  # which says what is wrong
    state = os.stat(path)
    return _loaded(path, state.st_mtime_ns, state.st_size)


class BoundTransfer:
    """One file in the scene that was drawn last.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    path : str
    damping : callable
        Gives factors of the degrees of the light for a bandlimit.
    reflected : bool
        Whether radiance is multiplied with the albedo of the file.

    Attributes
    ----------
    name : str
        Of the file.
    packed : CompressedTransfer
    albedo : TensorXf (V, 3)
        What vertices reflect; may be changed, and followed by gradients.
    """

    def __init__(self, mi: Any, path: str, damping: Callable[[int], NDArray[np.float64]], reflected: bool) -> None:
        self._mi = mi
        self.name = os.path.basename(path)
        self.packed = read_once(path)
        self._damping = damping(self.packed.bandlimit)
        self._reflected = reflected
        self._told_negative = False
        self.albedo = mi.TensorXf(np.ascontiguousarray(self.packed.mesh.albedo, dtype=np.float32))
        self._shapes: list[Any] = []
        self._emitter: Any = None
        self._surfaces: Any = None
        self._relit: Any = None

    def check_albedo(self) -> None:
        """Raise UserError if its shape was changed."""
        wanted = self.packed.mesh.albedo.shape
        if self.albedo.shape != wanted:
            raise UserError(f"albedo of {self.name} must have shape {wanted}, not {self.albedo.shape}")

    def find(self, scene: Any) -> bool:
        """Find the shapes of the file, again if another scene is drawn or vertices were moved; whether that was needed.

        Raises
        ------
        UserError
            As `Surfaces`; or transfer toward a camera in a model that is turned.
        """
        self._emitter = scene.environment()
        # The scene itself is not held: it holds the integrator. Its shapes are, so that no others are taken for them.
        shapes = list(scene.shapes())
        same = self._surfaces is not None and [s.ptr for s in shapes] == [s.ptr for s in self._shapes]
        if same and not self._surfaces.changed():
            return False
        surfaces = Surfaces(self._mi, scene, self.packed, self.name)
        turn = surfaces.placement.rotation.T
        if self.packed.toward_view and np.abs(turn - np.eye(3)).max() > 1e-4:
            raise UserError(f"{self.name}: holds transfer toward a camera, so its shapes cannot be turned")
        self._relit = Relit(self._mi, self.packed, turn, self._damping)
        self._surfaces, self._shapes = surfaces, shapes
        return True

    def remarks(self) -> list[str]:
        """What of the scene's materials is drawn otherwise than they say; for when shapes were found."""
        mi, notes = self._mi, []
        names = {part.name for part in self.packed.parts}
        known = [shape for shape, _ in self._surfaces.meshes]
        for shape in [*known, *(s for s in self._shapes if s.id() in names and s not in known)]:
            if not self.packed.toward_view:
                notes += [f"not drawn: {note}" for note in left_out(mi, shape.bsdf(), shape.id(), view=False)]
        told = mi.is_rgb and self._reflected and not self.packed.toward_view
        if not told or not np.all(self.packed.mesh.albedo == 1.0):
            return notes
        for shape, part in self._surfaces.meshes:
            own = self._surfaces.placement(self.packed.mesh.positions)[part.first : part.first + part.count]
            normals = self.packed.mesh.normals[part.first : part.first + part.count]
            faces = self._surfaces.faces_of(shape)
            try:
                mean = float(diffuse_reflectance(mi, shape, own, normals, faces, self.name).mean())
            except UserError:  # of a material that is not used here
                continue
            if mean < _ALL_REFLECTED:
                notes.append(
                    f"shape '{part.name}' reflects all light, as {self.name} has it; its material here reflects "
                    f"{mean:.2f}, which albedo 'scene' follows"
                )
        return notes

    def colour(self, ray: Any, hit: Any, si: Any, active: Any) -> tuple[Any, Any]:
        """Where rays meet the front of the surfaces, and linear sRGB radiance there.

        The arguments are those of `Surfaces.meet`.
        """
        import drjit as dr

        mi = self._mi
        unlit = self._relit.under(self._emitter)
        if self._relit.negative > _NEGATIVE and not self._told_negative:
            self._told_negative = True
            warn(
                mi,
                f"{self._relit.negative:.1%} of the vertices of {self.name} are negative under this light (ringing of "
                "small bright lights at this bandlimit; window and window_width damp it)",
            )
        with dr.suspend_grad():  # geometry is not differentiated
            met = self._surfaces.meet(ray, hit, si, active)
            self._check_camera(ray, met.held)
        colour = mi.Color3f(0.0)
        for vertex, weight in zip(met.vertices, met.weights, strict=True):
            lit = dr.gather(mi.Color3f, unlit, vertex, met.held)
            if self._reflected:
                lit *= dr.gather(mi.Color3f, self.albedo.array, vertex, met.held)
            colour += weight * lit
        return met.held, colour

    def _check_camera(self, ray: Any, held: Any) -> None:
        import drjit as dr

        view = self.packed.view
        if not self.packed.toward_view or view is None:
            return
        eye = self._mi.Point3f(np.array(view.to_world)[:3, 3].tolist())
        size = float(np.linalg.norm(np.ptp(self.packed.mesh.positions, axis=0)))
        if dr.any(held & (dr.norm(dr.cross(eye - ray.o, ray.d)) > 1e-3 * size)):
            raise UserError(f"{self.name}: holds transfer toward camera '{view.name}' alone; look from there")
