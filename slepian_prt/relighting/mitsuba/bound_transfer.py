"""A transfer file in a Mitsuba scene: its surfaces, lit, where camera rays meet them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.paths.lobes import PLAIN, material_kind
from slepian_prt.relighting.mitsuba.bounced_light import BouncedLight
from slepian_prt.relighting.mitsuba.held_files import HeldFile
from slepian_prt.relighting.mitsuba.missing_light import unknown_effects
from slepian_prt.relighting.mitsuba.remarks import log_warning
from slepian_prt.relighting.mitsuba.shape_matching import MatchedMesh, match_shapes, mesh_faces
from slepian_prt.relighting.mitsuba.surfaces import Surfaces
from slepian_prt.relighting.mitsuba.vertex_radiance import VertexRadiance
from slepian_prt.scene.reflectance.materials import diffuse_reflectance

# Warned of: mean reflectance of a material below this, where the file knows none; fraction of negative vertices above.
_ALL_REFLECTED = 0.99
_NEGATIVE = 1e-3


class BoundTransfer:
    """One file, bound to the scene that was drawn last.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    held : HeldFile
    damping : callable
        Gives factors of the degrees of the light for a bandlimit.
    fixed_lights : float
        Factor of what lamps send.

    Attributes
    ----------
    name : str
        Of the file.
    packed : CompressedTransfer
    albedo : TensorXf (V, 3)
        What vertices reflect; may be changed, and followed by gradients.
    """

    def __init__(
        self, mi: Any, held: HeldFile, damping: Callable[[int], NDArray[np.float64]], *, fixed_lights: float = 1.0
    ) -> None:
        if held.packed.film is not None:
            raise UserError(
                f"{held.name}: holds the pixels of a camera, which no other can look at; precompute the scene for the "
                "integrator, or relight the file as it is"
            )
        self._mi = mi
        self.name = held.name
        self.packed = held.packed
        self._lighting, self._lamps = held.lighting, held.lamps
        self.albedo = mi.TensorXf(np.ascontiguousarray(self.packed.mesh.albedo, dtype=np.float32))
        self._damping = damping(self.packed.bandlimit)
        self._fixed_lights = fixed_lights
        self._warned_of_negative = False
        # Of the scene that was drawn last. It is not held itself, because it holds the integrator; its shapes and
        # emitters are, so that no others are taken for them.
        self._objects: list[Any] = []
        self._matched: Any = None
        self._surfaces: Any = None
        self._vertex_radiance: Any = None
        self._bounced: Any = None
        self._unlit: Any = None

    def check_albedo(self) -> None:
        """Raise UserError if its shape was changed."""
        wanted = self.packed.mesh.albedo.shape
        if self.albedo.shape != wanted:
            raise UserError(f"albedo of {self.name} must have shape {wanted}, not {self.albedo.shape}")

    def bind(self, scene: Any) -> bool:
        """Match shapes and lamps of the file to a scene; again only if it has others, or vertices were moved.

        Returns
        -------
        Whether that was needed.

        Raises
        ------
        UserError
            As `match_shapes`; transfer toward a camera in a model that is turned; or, under CUDA, shapes that are found
            by their places in a scene without triangles.
        """
        objects = [*scene.shapes(), *scene.emitters()]
        same = self._matched is not None and [one.ptr for one in objects] == [one.ptr for one in self._objects]
        if same and not self._matched.vertices_changed(self._mi):
            return False
        matched = match_shapes(self._mi, scene, self.packed, self.name)
        turn = matched.placement.rotation.T
        if self.packed.toward_view and np.abs(turn - np.eye(3)).max() > 1e-4:
            raise UserError(f"{self.name}: holds transfer toward a camera, so its shapes cannot be turned")
        if matched.by_place and self._mi.variant().startswith("cuda_") and not _has_triangles(scene):
            raise UserError(
                f"{self.name}: its shapes are found by their places, for which OptiX needs a mesh in the scene, and "
                "there are round shapes alone: add a mesh, or draw in llvm_ad_rgb"
            )
        surfaces = Surfaces(self._mi, matched, self.packed.mesh, scene)
        self._vertex_radiance = VertexRadiance(self._mi, self.packed, turn, self._damping, self._lighting)
        self._bounced = BouncedLight(self._mi, self.packed.fixed, scene, self._fixed_lights, self._lamps)
        self._matched, self._surfaces, self._objects = matched, surfaces, objects
        return True

    def light(self, scene: Any) -> None:
        """Light the vertices as the scene that is bound has it now."""
        self._unlit = self._vertex_radiance.under(scene.environment())  # for unit albedo
        self._warn_of_negative()
        bounced = self._bounced.now()
        if bounced is not None:
            self._unlit = self._unlit + bounced

    def at(self, ray: Any, hit: Any, si: Any, active: Any, *, detached: bool) -> tuple[Any, Any, Any, Any]:
        """Whether this file holds what rays meet, and radiance for unit albedo, radiance and albedo as `Cached`.

        Parameters
        ----------
        ray, hit, si, active
            As of `Surfaces.intersect`.
        detached : bool
            Whether gradients stop here.
        """
        import drjit as dr

        mi = self._mi
        with dr.suspend_grad():  # geometry is not differentiated
            surface = self._surfaces.intersect(ray, hit, si, active)
        unlit, albedo = self._unlit, self.albedo.array
        if detached:
            unlit, albedo = dr.detach(unlit), dr.detach(albedo)
        else:
            self._check_camera(ray, surface.valid)
        unlit_here, radiance, albedo_here = mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0)
        for vertex, weight in zip(surface.vertices, surface.weights, strict=True):
            received = weight * dr.gather(mi.Color3f, unlit, vertex, surface.valid)
            reflected = dr.gather(mi.Color3f, albedo, vertex, surface.valid)
            unlit_here += received
            radiance += received * reflected
            albedo_here += weight * reflected
        return surface.valid, unlit_here, radiance, albedo_here

    def held_shapes(self) -> list[tuple[Any, int]]:
        """Shapes of the scene that is bound that are surely held wherever they are met, and on how many sides."""
        return [(one.shape, one.part.sides) for one in self._matched.meshes]

    def warnings(self, scene: Any, albedo: str, effects: tuple[str, ...]) -> list[str]:
        """What of the scene that is bound is drawn otherwise than it says.

        Parameters
        ----------
        scene : Mitsuba scene
        albedo : str
            Of the integrator.
        effects : tuple of str
            `scene_effects` of the scene.
        """
        texts = []
        unknown = unknown_effects(self.packed, effects)
        if unknown:
            texts.append(
                f"{self.name} was made without {', '.join(unknown)}: what these send onto its shapes, or keep from "
                "them, is missing; precompute the scene"
            )
        if self._bounced.unknown:
            names = ", ".join(self._bounced.unknown)
            texts.append(
                f"{self.name} does not know the light of {names}: it falls on its shapes, but what they send each "
                "other of it is missing"
            )
        is_lit = self._lighting is not None and np.any(self._lighting)
        if not is_lit and not any(True for _ in scene.emitters()):
            texts.append(f"without light the shapes of {self.name} are black")
        return texts + self._albedo_warnings(albedo)

    def _albedo_warnings(self, albedo: str) -> list[str]:
        """Of a file that says nothing of materials, and a scene that does; in its own scene that was asked for."""
        if not self._mi.is_rgb or albedo == "scene" or not np.all(self.packed.mesh.albedo == 1.0):
            return []
        if self.packed.toward_view or self._lamps is not None:  # its materials are in it
            return []
        texts = []
        for one in self._matched.meshes:
            if albedo == "auto" and material_kind(self._mi, one.shape.bsdf()) != PLAIN:
                continue  # as the scene has it
            reflectance = self._mean_reflectance(self._matched.positions, one)
            if reflectance is not None and reflectance < _ALL_REFLECTED:
                texts.append(
                    f"shape '{one.part.name}' reflects all light, as {self.name} has it; its material here reflects "
                    f"{reflectance:.2f}, which albedo 'scene' follows"
                )
        return texts

    def _mean_reflectance(self, positions: NDArray[np.float64], matched: MatchedMesh) -> float | None:
        """Of the diffuse part of a mesh's material; None if it cannot be evaluated, as it is not used."""
        shape, vertices = matched.shape, matched.vertices(self._mi)
        faces, normals = mesh_faces(self._mi, shape), self.packed.mesh.normals[vertices]
        try:
            reflectance = diffuse_reflectance(self._mi, shape, positions[vertices], normals, faces, self.name)
        except UserError:
            return None
        return float(reflectance.mean())

    def _warn_of_negative(self) -> None:
        """Once; relighting, which draws pictures of a file's own scene, tells it itself."""
        negative = self._vertex_radiance.negative
        if negative <= _NEGATIVE or self._warned_of_negative or self._lamps is not None:
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


def _has_triangles(scene: Any) -> bool:
    """Whether OptiX traces triangles in a Mitsuba scene; groups that instances stand for may have some."""
    return any(shape.is_mesh() or shape.class_name() == "Instance" for shape in scene.shapes())
