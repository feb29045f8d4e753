"""Light straight from the emitters of a scene, and how bright its lamps are."""

from __future__ import annotations

from typing import Any


class Lamps:
    """The emitters of a scene, to be sampled.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene

    Attributes
    ----------
    count : int
        Of emitters that are not the environment.
    """

    def __init__(self, mi: Any, scene: Any) -> None:
        self._mi, self._scene = mi, scene
        lamps = [mi.EmitterPtr(emitter) for emitter in scene.emitters() if not emitter.is_environment()]
        self.count, self._all = len(lamps), len(scene.emitters())
        distant = [mi.EmitterPtr(emitter) for emitter in scene.emitters() if emitter.is_environment()]
        self._emitters = _joined(mi, [*lamps, *distant])

    def sample(self, si: Any, sampler: Any, with_distant: Any, active: Any) -> tuple[Any, Any, Any]:
        """A direction to one of the emitters, each as likely.

        Parameters
        ----------
        si : SurfaceInteraction3f
        sampler : Sampler
        with_distant : Bool
            Whether the environment may be drawn.
        active : Bool

        Returns
        -------
        DirectionSample3f
            Of zero density where nothing arrives.
        UnpolarizedSpectrum
            What arrives, over that density.
        Bool
            Whether it comes from a lamp.
        """
        import drjit as dr

        mi = self._mi
        count = dr.select(with_distant, mi.UInt32(self._all), mi.UInt32(self.count))
        active = active & (count > 0)
        index = dr.minimum(mi.UInt32(sampler.next_1d() * mi.Float(count)), dr.maximum(count, 1) - 1)
        emitter = dr.gather(mi.EmitterPtr, self._emitters, index, active)
        ds, arriving = emitter.sample_direction(si, sampler.next_2d(), active)
        ds.pdf /= mi.Float(count)
        seen = active & (ds.pdf != 0.0)
        seen &= ~self._scene.ray_test(si.spawn_ray_to(ds.p), seen)
        ds.pdf = dr.select(seen, ds.pdf, 0.0)
        arriving = dr.select(seen, mi.unpolarized_spectrum(arriving) * mi.Float(count), 0.0)
        return ds, arriving, index < self.count

    def density(self, before: Any, ds: Any, active: Any) -> Any:
        """With which `sample` draws a direction, the environment being among the emitters."""
        import drjit as dr

        density = ds.emitter.pdf_direction(before, ds, active)
        return dr.select(active, density / max(self._all, 1), 0.0)


def _joined(mi: Any, emitters: list[Any]) -> Any:
    """Pointers as one array, with a null at the end."""
    import drjit as dr

    numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, emitter))[0]) for emitter in emitters]
    return dr.reinterpret_array(mi.EmitterPtr, mi.UInt32([*numbers, 0]))
