"""Mitsuba with the integrator, a file and its mesh, and what Mitsuba logs."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.renderer.variants import imported_mitsuba
from tests.conftest import bumpy
from tests.variants import VARIANT


@pytest.fixture
def mi():
    """Mitsuba in an LLVM variant with the integrator registered; the variant of before comes back."""
    module = imported_mitsuba()
    before = module.variant()
    module.set_variant(VARIANT)
    sp.register()
    yield module
    module.set_variant(before or "scalar_rgb")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A mesh with colours, its file without vertex normals merged, and its transfer."""
    path = tmp_path_factory.mktemp("integrator")
    mesh = bumpy(3)
    rng = np.random.default_rng(0)
    mesh = replace(mesh, name="bumpy", albedo=(0.3 + 0.5 * rng.random((len(mesh.positions), 3))).astype(np.float32))
    packed = sp.compress(sp.precompute(mesh, bandlimit=6, samples=256), tolerance=0.02, clusters=12)
    packed.save(path / "bumpy.prt", keep_order=True)  # as the vertices of the .ply
    trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False).export(path / "bumpy.ply")
    return path


@pytest.fixture
def log(mi):
    """What Mitsuba logs."""
    texts = []

    class Kept(mi.Appender):
        def append(self, level, text):
            texts.append(text)

        def log_progress(self, *_):
            pass

    logger = mi.logger()
    kept, before = Kept(), [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(kept)
    yield texts
    logger.clear_appenders()
    for appender in before:
        logger.add_appender(appender)
