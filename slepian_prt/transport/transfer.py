"""Transfer vectors of a scene and how they came about."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import check_bandlimit
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.scene.film import Film
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.summary import Summarised
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.effects import SIMULATED, UNKNOWN, Effect, are_unknown
from slepian_prt.transport.exchange import add_indirect, exchange_light
from slepian_prt.transport.fixed_lights import direct_fixed_lights
from slepian_prt.transport.glossy import merge_equal_channels, toward_camera
from slepian_prt.transport.interior import find_interior
from slepian_prt.transport.memory import check_transfer_memory
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings

if TYPE_CHECKING:
    from slepian_prt.scene.loading import SceneSource


@dataclass(frozen=True, repr=False)
class Transfer(Summarised):
    """How distant light becomes radiance at each vertex, before the albedo.

    t_lm = (1/π) ∫ V(ω) (n·ω)₊ y_lm(ω) dω for diffuse surfaces, V the visibility: with 1/π, so that a constant light of
    radiance 1 gives an unshadowed vertex the radiance 1; PIFu, ICON and GAMES202 leave it out (`convert_sh`). The y_lm
    are those of `real_sh`: index l² + l + m, orthonormal, Condon–Shortley phase, polar axis z; the axes are the
    model's.

    Attributes
    ----------
    vectors : (V, channels, (L+1)²) float32
        Real SH coefficients of the transfer function, for unit albedo of the receiver. One channel stands for all
        three where surfaces do not tint each other's light.
    axes : (V, 3) float64
        What transport is concentrated about: the normals, or toward a view the reflection directions. Zero at
        vertices without transfer.
    mesh : Mesh
        Its vertices are the receivers. Of unit albedo if the reflectance is in ``vectors``.
    parts : tuple of Part
    bandlimit, samples, seed : int
        Samples and seed are 0 of transfer that another program made.
    effects : tuple of Effect
        Of such transfer one row, whose verdict is ``unknown``.
    bounces : int
        Of light between surfaces.
    rays_traced : int
    seconds : dict of str to float
        Wall-clock time of each stage.
    source : str
        Path of the scene.
    parameters : dict of str to str
        What the ``$name`` of an .xml scene stood for.
    environment : Environment or None
        The scene's own distant light.
    view : View or None
        The scene's camera.
    toward_view : bool
        Whether ``vectors`` hold the light that all materials send toward that camera, reflectance included.
    fixed : FixedLights or None
        What the scene's lamps send, where it has any.
    film : Film or None
        Of a camera whose pixels are the receivers: the vertices of ``mesh``, which lies flat then.
    noise : float or None
        Relative RMS noise of ``vectors``, where paths were followed.
    """

    vectors: NDArray[np.float32]
    axes: NDArray[np.float64]
    mesh: Mesh
    parts: tuple[Part, ...]
    bandlimit: int
    samples: int
    seed: int
    effects: tuple[Effect, ...]
    bounces: int
    rays_traced: int
    seconds: dict[str, float] = field(default_factory=dict)
    source: str = ""
    parameters: Mapping[str, object] = field(default_factory=dict)
    environment: Environment | None = None
    view: View | None = None
    toward_view: bool = False
    fixed: FixedLights | None = None
    film: Film | None = None
    noise: float | None = None

    @property
    def positions(self) -> NDArray[np.float64]:
        """(V, 3) world space."""
        return self.mesh.positions

    @property
    def normals(self) -> NDArray[np.float64]:
        """(V, 3) unit normals, zero at vertices that no face uses."""
        return self.mesh.normals

    def at_bandlimit(self, bandlimit: int) -> Transfer:
        """The same transfer with fewer degrees, without the scene's own light.

        Raises
        ------
        UserError
            A bandlimit above that of the transfer.
        """
        bandlimit = check_bandlimit(bandlimit, largest=self.bandlimit)
        vectors = np.ascontiguousarray(self.vectors[:, :, : num_coefficients(bandlimit)])
        film = None if self.film is None else self.film.at_bandlimit(bandlimit)
        noise, size = self.noise, float(np.linalg.norm(vectors))
        if noise is not None and size > 0.0:  # alike in all coefficients
            kept = vectors.shape[2] / self.vectors.shape[2]
            noise *= math.sqrt(kept) * float(np.linalg.norm(self.vectors)) / size
        return replace(self, bandlimit=bandlimit, vectors=vectors, environment=None, film=film, noise=noise)

    def save(self, path: str | Path) -> None:
        """Write all of it, uncompressed, as a NumPy ``.npz`` file, which `load_transfer` reads back.

        Files of `compress` are smaller, and they are what the command line reads. The arrays here are ``vectors``,
        ``positions``, ``normals``, ``faces`` and ``albedo``, as the attributes are, and ``axes`` where they are not the
        normals.

        Raises
        ------
        UserError
            Another suffix, a folder that is missing or not writable, or a full disk.
        """
        from slepian_prt.transport.transfer_file import save_transfer

        save_transfer(self, path)

    def _summary(self) -> dict[str, object]:
        foreign = are_unknown(self.effects)
        simulated = ", ".join(effect.name for effect in self.effects if effect.verdict == SIMULATED) or "none"
        return {
            "source": self.source or self.mesh.name,
            "vertices": len(self.vectors),
            "bandlimit": self.bandlimit,
            "channels": self.vectors.shape[1],
            "samples": None if foreign else self.samples,
            "effects": UNKNOWN if foreign else simulated,
            "bounces": None if foreign else self.bounces,
            "rays_traced": None if foreign else self.rays_traced,
            "seconds": sum(self.seconds.values()),
            "environment": None if self.environment is None else self.environment.name,
            "noise": self.noise,
            "lamps": None if self.fixed is None else ", ".join(self.fixed.names),
            "film": None if self.film is None else f"{self.film.width} x {self.film.height} of {self.film.name}",
            "toward_camera": self.view.name if self.toward_view and self.view is not None else None,
        }


@one_blas_thread()
def precompute(
    scene: SceneSource,
    bandlimit: int = 10,
    samples: int = 1024,
    *,
    effects: str = "auto",
    bounces: int | None = None,
    albedo: ArrayLike | None = None,
    view: str | int | None = None,
    seed: int = 0,
    crease_angle: float | None = None,
    parameters: Mapping[str, object] | None = None,
    smooth: bool = True,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    client: Any = None,
) -> Transfer:
    """Transfer vectors of every vertex for distant light and diffuse surfaces.

    Parameters
    ----------
    scene : path, Mesh, trimesh.Trimesh, trimesh.Scene, mitsuba.Scene, mitsuba.Shape or dict
        Path of a mesh (ply, obj, stl, off, glb, gltf) or Mitsuba scene (xml). A ``trimesh.Scene`` becomes one mesh. Of
        trimesh's objects geometry and normals are taken, the normals if they hold them, not colours. A scene or a shape
        of Mitsuba is used as it is now, in the variant that it was made in (RGB, LLVM or CUDA), and is as before
        afterwards; load scenes with ``optimize=False``, as merged shapes have lost their names. A dict is one as of
        ``mitsuba.load_dict``.
    bandlimit : int in [0, 50]
    samples : int
        Rays per vertex over the hemisphere, on average; vertices that nothing can shadow get none.
    effects : str
        ``auto`` simulates what the scene calls for; ``direct`` shadows only; ``all``; ``none``; or some of shadows,
        interreflection, colour, with commas between.
    bounces : int, optional
        Of light between surfaces, where that is simulated. By default until the rest is less than a thousandth.
    albedo : one or three numbers in [0, 1], optional
        Diffuse reflectance of a mesh, instead of what its materials, textures and vertex colours say. Where they say
        nothing it is 1, and light between surfaces is left out.
    view : id or number of a camera of a Mitsuba scene, optional
        Transfer toward that camera, of all materials but mirrors and glass; direct light only.
    seed : int
        The same seed gives the same bits.
    crease_angle : float in [0, 180], optional
        Degrees: edges of a mesh file sharper than this are hard, where the file gives no normals. By default none is.
    parameters : dict of str to number, bool or str, optional
        Values of the parameters of an .xml scene, which stand there as ``$name``.
    smooth : bool
        Whether noise of light that comes by way of mirrors, glass and the like is taken out along the surface, as far
        as it was measured.
    on_plan : callable
        Given the effects plan before the heavy work begins.
    advance : callable
        Given (vertices finished since the last call, vertices in all).
    client : distributed.Client, or address of a scheduler, optional
        Whose workers do the work; the result is the same.

    Raises
    ------
    UserError
        The scene cannot be used, or no LLVM for Mitsuba works here.
    ValueError
        Bandlimit, samples, bounces or effects out of range.
    """
    settings = TransportSettings(
        bandlimit, samples, effects, bounces, albedo, view, seed, crease_angle, parameters, smooth
    )
    with (
        given_crew(client) as crew,
        plan_scene(scene, settings, on_plan) as planned,
        by_workers(planned, crew, scene) as shared,
    ):
        return compute_transfer(shared, advance)


def _work(planned: PlannedScene) -> int:
    """Receivers that stages finish, all stages together."""
    plan, total = planned.plan, len(planned.scene.receivers)
    if plan.view is not None:
        return total + (int(toward_camera(planned.scene, plan.view)[1].sum()) if plan.interreflection else 0)
    total += int(np.sum(~planned.within_media[plan.shadowed])) if plan.interreflection else 0
    return total + (plan.paths.receivers.size if plan.paths is not None else 0)


def compute_transfer(
    planned: PlannedScene, advance: Callable[[int, int], None] = lambda _done, _total: None
) -> Transfer:
    """All vectors of a planned scene, in memory.

    Parameters
    ----------
    planned : PlannedScene
    advance : callable
        Given (vertices finished since the last call, vertices in all).
    """
    scene, plan, settings = planned.scene, planned.plan, planned.settings
    receivers, mesh = scene.receivers, scene.mesh
    total = _work(planned)
    check_transfer_memory(planned)

    def report(done: int) -> None:
        advance(done, total)

    estimator = planned.estimator()
    whole = estimator.estimate(advance=report)
    vectors, blocked, rays = merge_equal_channels(whole.vectors), whole.blocked, whole.rays
    del whole  # three channels that were the same need not stay
    if planned.within_media.any():
        vectors[planned.within_media], blocked[planned.within_media] = 0.0, 1.0
    interior = find_interior(scene, np.flatnonzero((blocked >= 1.0) & receivers.active))
    interior.fill(vectors)
    interior.fill(blocked)
    planned.clock.stop("transport")
    fixed, fixed_rays = direct_fixed_lights(planned, interior)
    if fixed is not None:
        planned.clock.stop("fixed lights")
    rays += fixed_rays
    bounces, noise = 0, None
    if plan.view is not None and plan.interreflection:
        toward = add_indirect(planned, vectors, report)
        vectors, bounces, noise = toward.vectors, toward.bounces, toward.noise
        rays += toward.rays
    elif plan.interreflection or plan.paths is not None:
        exchanged = exchange_light(planned, vectors, fixed, blocked, interior, report)
        vectors, fixed, bounces, noise = exchanged.vectors, exchanged.fixed, exchanged.bounces, exchanged.noise
        rays += exchanged.rays
    if plan.view is not None:
        mesh = replace(mesh, albedo=np.ones_like(mesh.albedo))  # the reflectance is in the vectors
    return Transfer(
        vectors=vectors,
        axes=estimator.axes,
        mesh=mesh,
        parts=scene.parts,
        bandlimit=settings.bandlimit,
        samples=settings.samples,
        seed=settings.seed,
        effects=plan.effects,
        bounces=bounces,
        rays_traced=rays,
        seconds=dict(planned.clock.seconds),
        source=scene.path,
        parameters=dict(settings.parameters or {}),
        environment=scene.environment,
        view=scene.view,
        toward_view=plan.view is not None,
        fixed=fixed,
        noise=noise,
    )
