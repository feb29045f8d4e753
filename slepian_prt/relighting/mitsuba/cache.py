"""The files of an integrator as one cache: what they hold where rays meet a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slepian_prt.relighting.mitsuba.bound_transfer import BoundTransfer


@dataclass(frozen=True, eq=False)
class Cached:
    """What files hold at points of a scene, on Mitsuba's arrays.

    Attributes
    ----------
    valid : Bool
        Whether that is anything.
    unlit : Color3f
        Radiance of unit albedo there, linear sRGB.
    radiance : Color3f
        Of the albedo that the file has at its vertices.
    albedo : Color3f
        That albedo.
    toward_view : Bool
        Whether the radiance is that toward the camera, with the material in it.
    """

    valid: Any
    unlit: Any
    radiance: Any
    albedo: Any
    toward_view: Any


class RadianceCache:
    """Some files in one scene.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    transfers : sequence of BoundTransfer
        Where two hold the same surface, the first counts.
    """

    def __init__(self, mi: Any, transfers: Sequence[BoundTransfer]) -> None:
        self._mi, self._transfers = mi, transfers

    def at(self, ray: Any, hit: Any, si: Any, active: Any, *, first: Any = True) -> Cached:
        """What files hold where rays meet the scene.

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f
            Of the rays with the scene.
        si : SurfaceInteraction3f
            Of the same.
        active : Bool
        first : Bool
            Whether these are camera rays. Transfer toward a camera is nothing to others, and only ``True`` itself is
            differentiated.
        """
        import drjit as dr

        mi = self._mi
        camera = mi.Bool(first)
        found, toward = mi.Bool(False), mi.Bool(False)
        held = (mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0))
        for transfer in self._transfers:
            wanted = active & ~found
            if transfer.packed.toward_view:
                wanted &= camera
            here, *colours = transfer.at(ray, hit, si, wanted, detached=first is not True)
            held = tuple(dr.select(here, new, old) for new, old in zip(colours, held, strict=True))
            found |= here
            if transfer.packed.toward_view:
                toward |= here
        return Cached(found, *held, toward)
