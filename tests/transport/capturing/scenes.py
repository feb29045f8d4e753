"""Small scenes of Mitsuba, and a smooth map that spherical harmonics of degree 2 hold."""

from __future__ import annotations

import numpy as np

from slepian_prt.renderer.variants import imported_mitsuba
from slepian_prt.sphere.harmonics import real_sh
from tests.lighting.test_environment import grid_directions
from tests.variants import VARIANT

BANDLIMIT, ROWS = 2, 96
WHITE = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.75, 0.7, 0.6]}}}
RED = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.1, 0.05]}}}


def llvm_mitsuba():
    module = imported_mitsuba()
    module.set_variant(VARIANT)
    return module


def smooth_map(seed: int) -> np.ndarray:
    """A positive map of degrees 0 to 2, as fine as its bilinear interpolation must be."""
    values = real_sh(BANDLIMIT, grid_directions(ROWS).reshape(-1, 3)) @ np.random.default_rng(seed).normal(size=(9, 3))
    return (values - values.min(axis=0) + 0.2).reshape(ROWS, 2 * ROWS, 3).astype(np.float32)


def film(size: int = 24, **more) -> dict:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, **more}


def camera(mi, kind: str = "perspective", film_of: dict | None = None, **more) -> dict:
    place = mi.ScalarTransform4f().look_at([0, 1, 4.2], [0, 0.9, 0], [0, 1, 0])
    lens = {} if kind == "orthographic" else {"fov": 40}
    return {"type": kind, **lens, "to_world": place, "film": film() if film_of is None else film_of, **more}


def open_box(mi, **more) -> dict:
    """A box that is open to the front and above, with a ball of glass and a block that is a mirror."""
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "eye": camera(mi),
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90), "bsdf": WHITE},
        "back": {"type": "rectangle", "to_world": place().translate([0, 1, -1]), "bsdf": WHITE},
        "left": {"type": "rectangle", "to_world": place().translate([-1, 1, 0]).rotate([0, 1, 0], 90), "bsdf": RED},
        "ball": {"type": "sphere", "center": [0.45, 0.4, 0.35], "radius": 0.4, "bsdf": {"type": "dielectric"}},
        "block": {
            "type": "cube",
            "to_world": place().translate([-0.4, 0.5, -0.3]).rotate([0, 1, 0], 25).scale([0.28, 0.5, 0.28]),
            "bsdf": {"type": "conductor", "material": "Ag"},
        },
        **more,
    }


def under(mi, description: dict, texels: np.ndarray) -> object:
    """The scene under a map, as Mitsuba has it."""
    return mi.load_dict({**description, "sky": {"type": "envmap", "bitmap": mi.Bitmap(texels)}})
