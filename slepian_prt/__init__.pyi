# The public names: `__init__.py` loads them from here when they are used.
from .compression.compressed import CompressedTransfer as CompressedTransfer
from .compression.prt_file import load as load
from .compression.stream import compress as compress
from .errors import UserError as UserError
from .examples import example as example
from .lighting.environment import Environment as Environment
from .lighting.environment import read_environment as read_environment
from .lighting.projection import project_environment as project_environment
from .lighting.spectrum import falling_prior as falling_prior
from .lighting.spectrum import measured_prior as measured_prior
from .relighting.mitsuba.integrator import register as register
from .relighting.relight import relight as relight
from .scene.mesh import Mesh as Mesh
from .scene.mesh import make_mesh as make_mesh
from .scene.mesh_files import read_mesh as read_mesh
from .slepian.concentration import CapBasis as CapBasis
from .slepian.concentration import cap_basis as cap_basis
from .slepian.kernels import SecondMoment as SecondMoment
from .slepian.kernels import cosine_lobe as cosine_lobe
from .slepian.kernels import measured_moment as measured_moment
from .slepian.kernels import zonal_coefficients as zonal_coefficients
from .slepian.region_concentration import RegionBasis as RegionBasis
from .slepian.region_concentration import region_basis as region_basis
from .slepian.shannon import concentration_count as concentration_count
from .slepian.shannon import generalized_shannon_number as generalized_shannon_number
from .slepian.shannon import refined_shannon_number as refined_shannon_number
from .slepian.shannon import shannon_number as shannon_number
from .sphere.caps import minimal_enclosing_cap as minimal_enclosing_cap
from .sphere.harmonics import real_sh as real_sh
from .sphere.regions import cap_region as cap_region
from .sphere.regions import mask_region as mask_region
from .sphere.regions import polygon_region as polygon_region
from .sphere.rotation import rotate_sh as rotate_sh
from .transport.transfer import Transfer as Transfer
from .transport.transfer import precompute as precompute

__version__: str
