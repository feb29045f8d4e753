"""A transfer file in a Mitsuba scene: its surfaces, lit, where camera rays meet them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.relighting.mitsuba.held_files import HeldFile
from slepian_prt.relighting.mitsuba.shape_matching import MatchedShapes, match_shapes, part_vertices
from slepian_prt.relighting.mitsuba.surfaces import Surfaces, mesh_faces
from slepian_prt.relighting.mitsuba.vertex_radiance import VertexRadiance
from slepian_prt.scene.materials import diffuse_reflectance, left_out

# Warned of: mean reflectance of a material below this, where the file knows none; fraction of negative vertices above.
_ALL_REFLECTED = 0.99
_NEGATIVE = 1e-3


def log_warning(mi: Any, text: str) -> None:
    """A sentence in Mitsuba's log, bare: `mi.Log` puts the file, line and function of ours before it that called it."""
    level, logger, line = mi.LogLevel.Warn, mi.logger(), f"slepian_prt: {text}"
    if level >= logger.error_level():  # the user wants warnings to be errors
        mi.Log(level, line)
    elif level >= logger.log_level():
        for number in range(logger.appender_count()):
            logger.appender(number).append(level, line)


class BoundTransfer:
    """One file, bound to the scene that was drawn last.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    held : HeldFile
    damping : callable
        Gives factors of the degrees of the light for a bandlimit.
    use_albedo : bool
        Whether radiance is multiplied with the albedo of the file.

    Attributes
    ----------
    name : str
        Of the file.
    packed : CompressedTransfer
    albedo : TensorXf (V, 3)
        What vertices reflect; may be changed, and followed by gradients.
    """

    def __init__(
        self, mi: Any, held: HeldFile, damping: Callable[[int], NDArray[np.float64]], *, use_albedo: bool = True
    ) -> None:
        self._mi = mi
        self.name = held.name
        self.packed = held.packed
        self._lighting = held.lighting
        self.albedo = mi.TensorXf(np.ascontiguousarray(self.packed.mesh.albedo, dtype=np.float32))
        self._damping = damping(self.packed.bandlimit)
        self._use_albedo = use_albedo
        self._warned_of_negative = False
        # Of the scene that was drawn last. It is not held itself, because it holds the integrator; its shapes are, so
        # that no others are taken for them.
        self._shapes: list[Any] = []
        self._emitter: Any = None
        self._matched: Any = None
        self._surfaces: Any = None
        self._vertex_radiance: Any = None

    def check_albedo(self) -> None:
        """Raise UserError if its shape was changed."""
        wanted = self.packed.mesh.albedo.shape
        if self.albedo.shape != wanted:
            raise UserError(f"albedo of {self.name} must have shape {wanted}, not {self.albedo.shape}")

    def bind(self, scene: Any) -> bool:
        """Match the shapes of the file to a scene; again only if it is another one, or vertices were moved.

        Returns
        -------
        Whether that was needed.

        Raises
        ------
        UserError
            As `match_shapes`; or transfer toward a camera in a model that is turned.
        """
        self._emitter = scene.environment()
        shapes = list(scene.shapes())
        same = self._matched is not None and [s.ptr for s in shapes] == [s.ptr for s in self._shapes]
        if same and not self._matched.vertices_changed(self._mi):
            return False
        matched = match_shapes(self._mi, scene, self.packed, self.name)
        turn = matched.placement.rotation.T
        if self.packed.toward_view and np.abs(turn - np.eye(3)).max() > 1e-4:
            raise UserError(f"{self.name}: holds transfer toward a camera, so its shapes cannot be turned")
        surfaces = Surfaces(self._mi, matched, self.packed.mesh)
        self._vertex_radiance = VertexRadiance(self._mi, self.packed, turn, self._damping, self._lighting)
        self._matched, self._surfaces, self._shapes = matched, surfaces, shapes
        return True

    def radiance(self, ray: Any, hit: Any, si: Any, active: Any) -> tuple[Any, Any]:
        """Whether rays meet the front of the surfaces (Bool), and linear sRGB radiance there (Color3f).

        The arguments are those of `Surfaces.intersect`.
        """
        import drjit as dr

        mi = self._mi
        unlit = self._vertex_radiance.under(self._emitter)  # for unit albedo
        self._warn_of_negative()
        with dr.suspend_grad():  # geometry is not differentiated
            surface = self._surfaces.intersect(ray, hit, si, active)
            self._check_camera(ray, surface.valid)
        radiance = mi.Color3f(0.0)
        for vertex, weight in zip(surface.vertices, surface.weights, strict=True):
            reflected = dr.gather(mi.Color3f, unlit, vertex, surface.valid)
            if self._use_albedo:
                reflected *= dr.gather(mi.Color3f, self.albedo.array, vertex, surface.valid)
            radiance += weight * reflected
        return surface.valid, radiance

    def material_warnings(self) -> list[str]:
        """What the scene's materials say and is drawn otherwise; of the scene that was bound."""
        mi, matched = self._mi, self._matched
        texts = []
        if not self.packed.toward_view:
            names = {part.name for part in self.packed.parts}
            shapes = [shape for shape, _ in matched.meshes]
            shapes += [shape for shape in self._shapes if shape.id() in names and shape not in shapes]
            for shape in shapes:
                texts += [f"not drawn: {effect}" for effect in left_out(mi, shape.bsdf(), shape.id(), view=False)]
        file_says_nothing = np.all(self.packed.mesh.albedo == 1.0)
        if mi.is_rgb and self._use_albedo and not self.packed.toward_view and file_says_nothing:
            for shape, part in matched.meshes:
                reflectance = self._mean_reflectance(matched, shape, part_vertices(part))
                if reflectance is not None and reflectance < _ALL_REFLECTED:
                    texts.append(
                        f"shape '{part.name}' reflects all light, as {self.name} has it; its material here reflects "
                        f"{reflectance:.2f}, which albedo 'scene' follows"
                    )
        return texts

    def _mean_reflectance(self, matched: MatchedShapes, shape: Any, vertices: slice) -> float | None:
        """Of the diffuse part of a mesh's material; None if it cannot be evaluated, as it is not used."""
        faces = mesh_faces(self._mi, shape)
        normals = self.packed.mesh.normals[vertices]
        try:
            reflectance = diffuse_reflectance(self._mi, shape, matched.positions[vertices], normals, faces, self.name)
        except UserError:
            return None
        return float(reflectance.mean())

    def _warn_of_negative(self) -> None:
        negative = self._vertex_radiance.negative
        if negative <= _NEGATIVE or self._warned_of_negative:
            return
        self._warned_of_negative = True
        log_warning(
            self._mi,
            f"{negative:.1%} of the vertices of {self.name} are negative under this light (ringing of small bright "
            "lights at this bandlimit; window and window_width damp it)",
        )

    def _check_camera(self, ray: Any, active: Any) -> None:
        """Raise UserError if transfer toward a camera is looked at from elsewhere."""
        import drjit as dr

        view = self.packed.view
        if not self.packed.toward_view or view is None:
            return
        eye = self._mi.Point3f(np.array(view.to_world)[:3, 3].tolist())
        size = float(np.linalg.norm(np.ptp(self.packed.mesh.positions, axis=0)))
        if dr.any(active & (dr.norm(dr.cross(eye - ray.o, ray.d)) > 1e-3 * size)):
            raise UserError(f"{self.name}: holds transfer toward camera '{view.name}' alone; look from there")
