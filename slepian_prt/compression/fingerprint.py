"""What blocks of coefficients depend on, as one digest: the name under which finished work is kept."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.projection import Projection
from slepian_prt.scene.mitsuba.instances import shapes_in
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.planned import PlannedScene


def fingerprint(planned: PlannedScene, projection: Projection, blocks: Sequence[NDArray[np.int64]]) -> str:
    """Of everything that blocks of coefficients depend on, and which receivers are those of each."""
    digest = hashlib.sha256()
    scene, settings, plan, learned = planned.scene, planned.settings, planned.plan, projection.learned
    numbers = (version("slepian_prt"), scene.mi.variant(), settings.bandlimit, settings.seed, plan.nodes)
    digest.update(repr((*numbers, planned.estimator().block_size, scene.is_robust)).encode())
    mesh = scene.mesh
    arrays = [mesh.positions, mesh.normals, mesh.faces, plan.shadowed, scene.origin, scene.ray_heights]
    for shape in (*scene.shapes, *instanced_shapes(scene)):
        arrays += shape_arrays(scene.mi, shape)
    arrays += [np.array([block.size for block in blocks]), *blocks]
    arrays += [learned.normals, learned.clusters.index, *(basis.analysis for basis in projection.bases)]
    if learned.pilot is not None and learned.pilot.mean is not None:
        arrays.append(learned.pilot.mean.zonal)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def instanced_shapes(scene: Scene) -> list[Any]:
    """The shapes that instances among those of a scene stand for."""
    return [shape for group in scene.groups for shape in shapes_in(scene.mi, group)]


def shape_arrays(mi: Any, shape: Any) -> list[NDArray]:
    """What a Mitsuba shape of any kind is made of: its box, and vertices, control points or transform.

    Not its area, which curves and ellipsoids do not know.
    """
    box = shape.bbox()
    arrays = [np.array(box.min), np.array(box.max), np.array([shape.primitive_count()])]
    parameters = mi.traverse(shape)
    for name in parameters.keys():  # noqa: SIM118 (going through pairs, Mitsuba fails at what a hair BSDF leaves unset)
        if "." not in name:  # not of its material or light
            # An array of a Mitsuba transform would hold its address.
            arrays.append(np.array(getattr(parameters[name], "matrix", parameters[name])))
    return arrays
