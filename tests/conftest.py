"""Shared fixtures: real data if it is there, and small scenes with known answers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from slepian_prt.distributed.crew import Crew, open_crew
from slepian_prt.scene.mesh import Mesh, make_mesh
from tests.browser import open_chromium

ROOT = Path(__file__).parent.parent


def pytest_configure() -> None:
    """A variant that was asked for and does not work here ends it all, in one line."""
    from slepian_prt.errors import UserError
    from slepian_prt.renderer.variants import usable_variant

    try:
        usable_variant()
    except UserError as error:
        pytest.exit(str(error), returncode=2)


@pytest.fixture
def cuda() -> Iterator[Any]:
    """Mitsuba in cuda_ad_rgb; tests that need it are skipped where there is no device."""
    from slepian_prt.renderer.variants import chosen_variant, cuda_failure, imported_mitsuba

    if failure := cuda_failure():
        pytest.skip(f"CUDA: {failure}")
    with chosen_variant("cuda_ad_rgb"):
        yield imported_mitsuba()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of scanned meshes and HDR maps."""
    folder = os.environ.get("SLEPIAN_PRT_DATA")
    if not folder:
        pytest.skip("SLEPIAN_PRT_DATA is not set: no scanned meshes and HDR maps")
    return Path(folder)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Playwright's headless Chromium, one for a process: a second would be refused. Tests without one are skipped."""
    with open_chromium() as chromium:
        yield chromium


@pytest.fixture(scope="module")
def crew() -> Iterator[Crew]:
    """Two workers of a local cluster, in processes of their own; Dask's threads end with the module that needs them."""
    pytest.importorskip("distributed")
    with open_crew(workers=2) as opened:
        yield opened


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20101)


def sphere(subdivisions: int = 3, radius: float = 1.0) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions, radius)
    return make_mesh(ball.vertices, ball.faces, name="sphere")


def bumpy(subdivisions: int = 4) -> Mesh:
    """A self-shadowing ball, a few thousand vertices."""
    ball = trimesh.creation.icosphere(subdivisions)
    radius = 1.0 + 0.25 * np.prod(np.sin(4.0 * ball.vertices), axis=1) + 0.15 * np.sin(5.0 * ball.vertices[:, 0])
    return make_mesh(ball.vertices * radius[:, None], ball.faces, name="bumpy")


def inside_out(mesh: Mesh) -> Mesh:
    """The same surface seen from the other side."""
    return make_mesh(mesh.positions, mesh.faces[:, ::-1], name=mesh.name)


def random_directions(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
