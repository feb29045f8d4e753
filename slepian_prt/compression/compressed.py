"""Compressed transfer: plain data, as a file holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.clustering import Clusters, typical_half_angle
from slepian_prt.compression.codec.caps import Coded
from slepian_prt.compression.files.file_size import file_size
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import MeanTransfer
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.stored_mesh.stored import StoredMesh
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.lighting.spectrum import expected_power
from slepian_prt.scene.film import Film, FilmOutline
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.scene.view import View
from slepian_prt.summary import Summarised
from slepian_prt.transport.effects import Effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """What is told of transfer without its numbers.

    Attributes
    ----------
    name : str
    notes : tuple of str
    vertices, faces, caps : int
    coding : str
    prior_weights : (L+1,) or None
    lamps : tuple of str
    film : FilmOutline or None
    half_angle : float or None
        See `CompressedTransfer.typical_half_angle`.
    """

    name: str
    notes: tuple[str, ...]
    vertices: int
    faces: int
    caps: int
    coding: str
    prior_weights: NDArray[np.float64] | None
    lamps: tuple[str, ...]
    film: FilmOutline | None
    half_angle: float | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CompressedTransfer(Summarised):
    """Everything needed to relight a scene.

    Attributes
    ----------
    mesh : Mesh
        As the file has it, quantised; its vertices in the order of the source, or of the file if that holds no other.
    stored : StoredMesh or None
        What the file has of it; None of a film.
    parts : tuple of Part
    bandlimit : int
    basis : str
        Name of the basis.
    bases : tuple of LinearBasis
        One per cap.
    clusters : Clusters
    channels : 1 or 3
        Of the transfer; three are stored decorrelated, see `channel_mixing`.
    coefficients : tuple of (n_c, K_c channels) float16 or float32 arrays
        In the order of ``clusters.members``; empty if coded.
    coded : Coded or None
    mean : MeanTransfer or None
        What the coefficients are added to, told by the normal alone.
    terms : float
        Mean number of functions per vertex, the mean of ``pca`` counted as one; if coded, those that are used.
    prior : str
        Name of the light prior, if any.
    expected : Expectation
        What the pilot lets expect to be lost, in each degree; of coded coefficients, what rounding lost is in it.
    effects : tuple of Effect
    bounces, samples, seed, rays_traced : int
    path_noise : float or None
        Relative RMS noise of the vectors that were compressed, where paths were followed.
    seconds : dict of str to float
    source : str
    parameters : dict of str to str
        What the ``$name`` of an .xml scene stood for.
    lighting : (3, (L+1)²) or None
        Of the scene's own distant light.
    view : View or None
        The scene's camera.
    toward_view : bool
        Whether this is transfer toward that camera.
    fixed : FixedLights or None
        What the scene's lamps send, where it has any.
    film : Film or None
        Of a camera whose pixels are the receivers.
    verified : dict of str to float
        Where a goal was set: relative RMS errors of relit radiance, measured on vertices held out, by light.
    verified_vertices : int
        How many were held out.
    verified_left_out : dict of str to dict of str to int
        Of them, how many do not count in the error, by light: ``inside`` other geometry, and else ``black`` in the
        reference.
    """

    mesh: Mesh
    stored: StoredMesh | None
    parts: tuple[Part, ...]
    bandlimit: int
    basis: str
    bases: tuple[LinearBasis, ...]
    clusters: Clusters
    channels: int
    coefficients: tuple[NDArray, ...] = ()
    coded: Coded | None = None
    mean: MeanTransfer | None = None
    terms: float
    prior: str = ""
    expected: Expectation
    effects: tuple[Effect, ...]
    bounces: int
    samples: int
    seed: int
    rays_traced: int
    path_noise: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    source: str = ""
    parameters: Mapping[str, object] = field(default_factory=dict)
    lighting: NDArray[np.float64] | None = None
    view: View | None = None
    toward_view: bool = False
    fixed: FixedLights | None = None
    film: Film | None = None
    verified: dict[str, float] = field(default_factory=dict)
    verified_vertices: int = 0
    verified_left_out: dict[str, dict[str, int]] = field(default_factory=dict)

    # Told without decoding anything where it was loaded from a file.

    @cached_property
    def _outline(self) -> Outline:
        return Outline(
            name=self.mesh.name,
            notes=self.mesh.notes,
            vertices=len(self.mesh.positions),
            faces=len(self.mesh.faces),
            caps=len(self.bases),
            coding="coded" if self.coded is not None else str(self.coefficients[0].dtype),
            prior_weights=self.bases[0].weights,
            lamps=() if self.fixed is None else self.fixed.names,
            film=None if self.film is None else self.film.outline,
            half_angle=typical_half_angle(self.clusters, self.mesh.receivers.active),
        )

    @property
    def coding(self) -> str:
        """coded, float16 or float32."""
        return self._outline.coding

    @property
    def name(self) -> str:
        """Of the mesh or camera."""
        return self._outline.name

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired in the mesh."""
        return self._outline.notes

    @property
    def vertex_count(self) -> int:
        """V."""
        return self._outline.vertices

    @property
    def face_count(self) -> int:
        """F."""
        return self._outline.faces

    @property
    def cap_count(self) -> int:
        """Number of caps."""
        return self._outline.caps

    @property
    def typical_half_angle(self) -> float | None:
        """Median half-angle, in radians, of the caps that vertices with light belong to.

        None for a file that does not say it, as older ones do not: the caps tell, once they are decoded.
        """
        return self._outline.half_angle

    @property
    def lamp_names(self) -> tuple[str, ...]:
        """Of the scene's lamps."""
        return self._outline.lamps

    @property
    def film_outline(self) -> FilmOutline | None:
        """Of the film whose pixels these are, if they are such."""
        return self._outline.film

    @property
    def prior_weights(self) -> NDArray[np.float64] | None:
        """(L+1,) weights of the light prior; None without one."""
        return self._outline.prior_weights

    @property
    def predicted_error(self) -> float:
        """Expected relative RMS error of the transfer vectors, or of radiance under white light."""
        return self.expected.relative()

    @property
    def predicted_error_under_prior(self) -> float | None:
        """The same under light of the prior, which is what a tolerance is about; None without one."""
        weights = self.prior_weights
        return None if weights is None else self.expected.relative(weights**2)

    def predicted_relit_error(self, lighting: NDArray | None = None) -> float:
        """Expected relative RMS error of radiance, averaged over the rotations of the light.

        Parameters
        ----------
        lighting : (3, (L+1)²), optional
            By default light that falls as 1/(l+1)².
        """
        return self.expected.relative(expected_power(lighting, self.bandlimit))

    def noise(self, lighting: NDArray | None = None) -> float | None:
        """Relative RMS noise of a captured picture, averaged over the rotations of the light; None where none is known.

        ``lighting`` as of `predicted_relit_error`.
        """
        if self.film_outline is None:
            return None
        power = expected_power(lighting, self.bandlimit)
        return self.film_outline.relative_noise(self.channels * self.expected.total, power)  # expected of each channel

    @property
    def bytes_per_vertex(self) -> float:
        """Bytes in the file per vertex for coefficients, bases, caps and cluster indices.

        Not counted are the mesh, and the light of lamps: 2 to 12 bytes for each, less where it is dark or gray.
        """
        return file_size(self).transfer / self.vertex_count

    @property
    def mesh_bytes_per_vertex(self) -> float:
        """Bytes in the file per vertex for its mesh."""
        return file_size(self).mesh / self.vertex_count

    @property
    def file_bytes_per_vertex(self) -> float:
        """Bytes of the whole file per vertex."""
        return file_size(self).whole / self.vertex_count

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(V, 3) as the file has them."""
        return self.mesh.normals.astype(np.float32).astype(np.float64)

    # What is done with the data stands in modules of its own; these are shortcuts to it.

    def reconstruct(self, vertices: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Transfer vectors as the file has them.

        Parameters
        ----------
        vertices : (n,), optional
            Only those, in their order.

        Returns
        -------
        (V, channels, (L+1)²) float32, as `Transfer.vectors` are

        Raises
        ------
        UserError
            A vertex that is not there.
        """
        from slepian_prt.compression.decoder import reconstruct

        return reconstruct(self, vertices)

    def save(self, path: str | Path, *, keep_order: bool = False) -> None:
        """Write a ``.prt`` file: complete or not at all.

        Parameters
        ----------
        path : path
        keep_order : bool
            Whether the vertices of what is loaded are to stand in the order that they have here; by default they stand
            in that of the file, which takes 2 bytes less for each.

        Raises
        ------
        UserError
            The folder is missing or not writable, or the disk is full.
        """
        from slepian_prt.compression.files.prt_file import save

        save(self, path, keep_order=keep_order)

    def _summary(self) -> dict[str, object]:
        film = self.film_outline
        verified = ", ".join(f"{light} {error:.2g}" for light, error in self.verified.items())
        return {
            "source": self.source or self.name,
            "vertices": self.vertex_count,
            "bandlimit": self.bandlimit,
            "channels": self.channels,
            "basis": self.basis,
            "terms": float(self.terms),
            "caps": self.cap_count,
            "coding": self.coding,
            "bytes_per_vertex": self.bytes_per_vertex,
            "file_bytes_per_vertex": self.file_bytes_per_vertex,
            "predicted_error": self.predicted_error,
            "path_noise": self.path_noise,
            "light_prior": self.prior or None,
            "verified_error": verified or None,
            "lamps": ", ".join(self.lamp_names) or None,
            "film": None if film is None else f"{film.width} x {film.height} of {film.name}",
            "toward_camera": self.view.name if self.toward_view and self.view is not None else None,
        }
