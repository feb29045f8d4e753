"""Compressed precomputed radiance transfer on spherical Slepian functions, built on Mitsuba 3.

    import slepian_prt as sp
    transfer = sp.precompute("skull.ply", bandlimit=10, samples=1024)
    packed = sp.compress(transfer, basis="adapted", tolerance=0.02)
    lighting = sp.project_environment("studio.exr", bandlimit=10)
    radiance = sp.relight(packed, lighting)

Names are loaded when they are first used, so the sphere mathematics works where Mitsuba cannot run.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.compression.prt_file import load
    from slepian_prt.compression.stream import compress
    from slepian_prt.errors import UserError
    from slepian_prt.lighting.environment import Environment, read_environment
    from slepian_prt.lighting.projection import project_environment
    from slepian_prt.lighting.spectrum import falling_prior, measured_prior
    from slepian_prt.relighting.mitsuba.integrator import register
    from slepian_prt.relighting.relight import relight
    from slepian_prt.scene.mesh import Mesh, make_mesh, read_mesh
    from slepian_prt.slepian.concentration import CapBasis, RegionBasis, cap_basis, region_basis
    from slepian_prt.slepian.kernels import SecondMoment, cosine_lobe, measured_moment, zonal_coefficients
    from slepian_prt.slepian.shannon import (
        concentration_count,
        generalized_shannon_number,
        refined_shannon_number,
        shannon_number,
    )
    from slepian_prt.sphere.caps import minimal_enclosing_cap
    from slepian_prt.sphere.harmonics import real_sh
    from slepian_prt.sphere.regions import cap_region, mask_region, polygon_region
    from slepian_prt.sphere.rotation import rotate_sh
    from slepian_prt.transport.transfer import Transfer, precompute

_HOME = {
    "CapBasis": "slepian.concentration",
    "CompressedTransfer": "compression.compressed",
    "Environment": "lighting.environment",
    "Mesh": "scene.mesh",
    "RegionBasis": "slepian.concentration",
    "SecondMoment": "slepian.kernels",
    "Transfer": "transport.transfer",
    "UserError": "errors",
    "cap_basis": "slepian.concentration",
    "cap_region": "sphere.regions",
    "compress": "compression.stream",
    "concentration_count": "slepian.shannon",
    "cosine_lobe": "slepian.kernels",
    "generalized_shannon_number": "slepian.shannon",
    "falling_prior": "lighting.spectrum",
    "load": "compression.prt_file",
    "make_mesh": "scene.mesh",
    "mask_region": "sphere.regions",
    "measured_prior": "lighting.spectrum",
    "measured_moment": "slepian.kernels",
    "minimal_enclosing_cap": "sphere.caps",
    "polygon_region": "sphere.regions",
    "precompute": "transport.transfer",
    "project_environment": "lighting.projection",
    "read_environment": "lighting.environment",
    "read_mesh": "scene.mesh",
    "real_sh": "sphere.harmonics",
    "refined_shannon_number": "slepian.shannon",
    "region_basis": "slepian.concentration",
    "register": "relighting.mitsuba.integrator",
    "relight": "relighting.relight",
    "rotate_sh": "sphere.rotation",
    "shannon_number": "slepian.shannon",
    "zonal_coefficients": "slepian.kernels",
}

__all__ = [*sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
