"""The Mitsuba integrator ``slepian_prt_capture``: any film filled with coefficients of transfer."""

from __future__ import annotations

from typing import Any

from slepian_prt.errors import UserError, check_bandlimit, check_integer
from slepian_prt.lighting.formats.coefficient_layers import BACKGROUND, channel_names
from slepian_prt.paths.harmonics import sh_values
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.relighting.mitsuba.remarks import log_warning
from slepian_prt.transport.settings import LARGEST_BANDLIMIT

CAPTURE_NAME = "slepian_prt_capture"

_DEFAULT_BANDLIMIT = 4
_DEEPEST = (1 << 31) - 1


def capture_plugin(mi: Any) -> Any:
    """The class of the current variant."""

    class SlepianCapture(mi.SamplingIntegrator):
        __doc__ = CaptureIntegrator.__doc__

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.integrator = CaptureIntegrator(mi, properties)

        def aov_names(self) -> list[str]:
            return self.integrator.names

        def to_string(self) -> str:
            return str(self.integrator)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            try:
                return self.integrator.sample(scene, sampler, ray, medium, active)
            except UserError as error:
                log_warning(mi, str(error))  # `mi.render` raises an error of its own that does not say what is wrong
                raise

    return SlepianCapture


class CaptureIntegrator:
    """Transfer toward the pixels of any sensor, as channels of its film.

    The picture itself is that under a sky of radiance 1. Behind it come the channels that `write_coefficients` names:
    ``l02.m-01.R`` is the coefficient of degree 2, order -1, in red. Under distant light e the radiance of a pixel is
    Σ e_lm times these, plus ``background.R`` times the radiance right behind it. What emits light in the scene does
    not count.

    ==============  =======  ========================================================================================
    Parameter       Type     Meaning
    ==============  =======  ========================================================================================
    ``bandlimit``   integer  Highest degree L; 3 (L+1)² channels. By default 4.
    ``max_depth``   integer  Longest path, as of ``path``. By default -1: no limit.
    ``rr_depth``    integer  Steps after which paths end by Russian roulette. By default 5.
    ==============  =======  ========================================================================================

    It works in the RGB variants ``llvm_*`` and ``cuda_*``. All samples of a picture are held at once, 12 (L+1)² bytes
    each; ``slepian-prt capture`` works in blocks, stratifies, smooths and compresses.
    """

    def __init__(self, mi: Any, properties: Any) -> None:
        if not mi.is_rgb or mi.is_polarized:
            raise UserError(f"{CAPTURE_NAME} needs an RGB variant of Mitsuba without polarization, not {mi.variant()}")
        self._mi = mi
        self._bandlimit = check_bandlimit(properties.get("bandlimit", _DEFAULT_BANDLIMIT), largest=LARGEST_BANDLIMIT)
        self._max_depth = check_integer(properties.get("max_depth", -1), "max_depth", -1, _DEEPEST)
        self._rr_depth = check_integer(properties.get("rr_depth", 5), "rr_depth", 1, _DEEPEST)
        self.names = [*channel_names(self._bandlimit), *BACKGROUND]

    def __str__(self) -> str:
        return f"SlepianCapture[bandlimit={self._bandlimit}, max_depth={self._max_depth}, rr_depth={self._rr_depth}]"

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any, active: Any) -> tuple[Any, Any, list[Any]]:
        """Radiance under a sky of 1, whether there was anything on the way, and all channels."""
        import drjit as dr

        mi = self._mi
        materials = [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.BSDF)]
        tracer = PathTracer(mi, scene, materials, max_depth=self._max_depth, rr_depth=self._rr_depth)
        ends = tracer.follow(sampler, mi.Ray3f(ray), medium=medium, active=active)
        carried = dr.select(ends.escaped, ends.throughput, 0.0)
        reflected = dr.select(ends.covered, carried, 0.0)
        values = sh_values(mi, self._bandlimit, mi.Vector3f(ends.ray.d))
        channels = [reflected[c] * value for value in values for c in range(3)]
        return mi.Spectrum(carried), ends.covered, channels + [carried[c] - reflected[c] for c in range(3)]
