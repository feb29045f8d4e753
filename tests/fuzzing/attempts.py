"""One damaged input of each kind, made from a seed and used as a user would.

Each attempt returns normally or raises UserError; anything else is a fault.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np

import slepian_prt as sp
from slepian_prt.compression.files.prt_file import content_of
from slepian_prt.scene.loading import open_scene
from tests.conftest import bumpy
from tests.fuzzing import journals, maps, meshes, prt_files, scenes


class Kind(NamedTuple):
    """A kind of input.

    Attributes
    ----------
    prepare : callable
        Given a folder that is empty, puts there what attempts begin with.
    attempt : callable
        Given a folder of its own, that of `prepare` and a generator of random numbers; what it returns is compared with
        nothing.
    """

    prepare: Callable[[Path], None]
    attempt: Callable[[Path, Path, Random], None]


def _write(files: dict[str, bytes], folder: Path) -> None:
    for name, content in files.items():
        (folder / name).write_bytes(content)


def _copied(seeds: Path, folder: Path) -> None:
    shutil.copytree(seeds, folder, dirs_exist_ok=True)


def _try_prt(folder: Path, seeds: Path, random: Random) -> None:
    """Load a transfer file, and use all of it."""
    source = random.choice(sorted(seeds.glob("*.prt")))
    path = folder / "damaged.prt"
    path.write_bytes(prt_files.mutate(source.read_bytes(), random))
    transfer = sp.load(path)
    repr(transfer)
    lighting = np.ones((3, (transfer.bandlimit + 1) ** 2))
    radiance = sp.relight(transfer, lighting)
    assert radiance.shape == (transfer.vertex_count, 3)
    assert np.isfinite(radiance).all()
    assert np.isfinite(transfer.predicted_relit_error(lighting))
    assert transfer.reconstruct().shape == (transfer.vertex_count, transfer.channels, lighting.shape[1])


def _try_mesh(folder: Path, seeds: Path, random: Random) -> None:
    """Read a mesh."""
    name = random.choice(sorted(meshes.seeds()))
    _copied(seeds, folder)
    (folder / name).write_bytes(meshes.mutate(name, (seeds / name).read_bytes(), random))
    mesh = sp.read_mesh(folder / meshes.READ_BY.get(name, name))
    assert np.isfinite(mesh.positions).all()
    assert np.isfinite(mesh.normals).all()
    assert np.all((mesh.albedo >= 0.0) & (mesh.albedo <= 1.0))
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.positions)


def _try_map(folder: Path, seeds: Path, random: Random) -> None:
    """Project a map, or read transfer as text."""
    name = random.choice(sorted(maps.seeds()))
    path = folder / name
    path.write_bytes(maps.mutate(name, (seeds / name).read_bytes(), random))
    if name == "transport.txt":
        triangles = sp.make_mesh(np.random.default_rng(3).random((6, 3)), [[0, 1, 2], [3, 4, 5]])
        vectors = sp.load_transfer(path, mesh=triangles).vectors
        assert np.isfinite(vectors).all()
        return
    assert np.isfinite(sp.project_environment(path, 3)).all()


def _try_scene(folder: Path, seeds: Path, random: Random) -> None:
    """Open a scene."""
    name = random.choice(sorted(scenes.seeds()))
    _copied(seeds, folder)
    (folder / name).write_bytes(scenes.mutate(name, (seeds / name).read_bytes(), random))
    with open_scene(str(folder / name)) as scene:
        assert np.isfinite(scene.mesh.positions).all()


# --- Journals --------------------------------------------------------------------------------------------------------


class _StoppedError(Exception):
    pass


def _job(report: Callable[[str], None] = lambda _: None) -> sp.CompressedTransfer:
    return sp.precompute_compressed(bumpy(3), bandlimit=2, samples=16, tolerance=0.1, report=report)


def _stop(stage: str) -> None:
    if stage == "coding":
        raise _StoppedError


def _arrays(transfer: sp.CompressedTransfer) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in content_of(transfer)[1].items()}


def _prepare_journals(folder: Path) -> None:
    """The journal of a job that was stopped before its end."""
    os.environ["SLEPIAN_PRT_CACHE"] = str(folder / "cache")
    try:
        _job(_stop)
    except _StoppedError:
        return
    raise AssertionError("the job kept no journal")


_expected: dict[str, bytes] = {}


def _try_journal(folder: Path, seeds: Path, random: Random) -> None:
    """Go on from a damaged journal; the file must be that of a job that was never stopped."""
    if not _expected:
        os.environ["SLEPIAN_PRT_CACHE"] = str(folder / "other")
        _expected.update(_arrays(_job()))
    _copied(seeds / "cache", folder / "cache")
    journals.damage(folder / "cache", random)
    os.environ["SLEPIAN_PRT_CACHE"] = str(folder / "cache")
    assert _arrays(_job()) == _expected


KINDS = {
    "prt": Kind(prt_files.write_seeds, _try_prt),
    "meshes": Kind(meshes.write_seeds, _try_mesh),
    "maps": Kind(lambda folder: _write(maps.seeds(), folder), _try_map),
    "journals": Kind(_prepare_journals, _try_journal),
    "scenes": Kind(scenes.write_seeds, _try_scene),
}
