"""One damaged input of each kind, made from a seed and used as a user would.

Each attempt returns normally or raises UserError; anything else is a fault.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

import slepian_prt as sp
from slepian_prt.compression.files.prt_file import content_of
from slepian_prt.evaluation.dimension.caps import cap_dimensions
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport import direct
from tests.conftest import bumpy
from tests.fuzzing import journals, maps, meshes, npz_files, prt_files, scenes


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


# A scene with lamps, whose files hold them, and a camera.
_LIT = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world"><lookat origin="0,1,4" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film></sensor>
<emitter type="point" id="lamp"><point name="position" value="1,2,1"/><rgb name="intensity" value="4,3,2"/></emitter>
<shape type="sphere" id="ball"><float name="radius" value="0.7"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0.8,0.4,0.2"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/><translate y="-0.7"/>
</transform></shape>
<shape type="cube"><transform name="to_world"><scale value="0.2"/><translate x="1"/></transform></shape></scene>"""


def _prepare_prt(folder: Path) -> None:
    """Transfer files of every kind: each way to store a basis, coefficients, a mesh, lamps and a film."""
    transfer = sp.precompute(bumpy(2), bandlimit=4, samples=16)
    kinds: dict[str, dict[str, Any]] = {
        "coded": {"tolerance": 0.1, "clusters": 6},
        "float32": {"basis": "transport", "terms": 6, "clusters": 6},
        "float16": {"terms": 6, "clusters": 6, "coding": "float16", "refine": True},
        "all": {"basis": "none"},
        "cpca": {"basis": "cpca", "terms": 5, "clusters": 5, "coding": "coded"},
        "surface": {"tolerance": 0.1, "clusters": 6, "group_by": "surface"},
        "bent": {"tolerance": 0.1, "clusters": 6, "group_by": "bent", "occlusion_classes": 2},
        "exact": {"tolerance": 0.1, "clusters": 4, "exact_mesh": True, "light_prior": sp.falling_prior(4)},
    }
    for name, settings in kinds.items():
        sp.compress(transfer, **settings).save(folder / f"{name}.prt", keep_order=name == "coded")
    scene = folder / "lit.xml"
    scene.write_text(_LIT)
    sp.precompute_compressed(scene, bandlimit=3, samples=16, tolerance=0.1).save(folder / "lit.prt")
    sp.compress_film(sp.capture(scene, bandlimit=2, samples=4), tolerance=0.2).save(folder / "film.prt")


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
    if random.randrange(10) == 0:
        _export(transfer, folder)


def _export(transfer: sp.CompressedTransfer, folder: Path) -> None:
    """Use a file in all other ways: some refuse what is no fault, such as pixels instead of a mesh."""
    uses: tuple[Callable[[], object], ...] = (
        lambda: cap_dimensions(transfer, 0.05),
        lambda: sp.gpu_transfer(transfer, 8),
        lambda: sp.save_page(folder / "page.html", transfer),
        lambda: sp.export_model(transfer, folder / "model.glb"),
        lambda: transfer.save(folder / "again.prt"),
        lambda: sp.load(folder / "again.prt"),
    )
    for use in uses:
        with suppress(sp.UserError):
            use()


def _prepare_npz(folder: Path) -> None:
    """Files of `Transfer.save`: of a mesh, of a scene with lamps and a camera, of its pixels, and of a sky."""
    sp.precompute(bumpy(2), bandlimit=3, samples=16).save(folder / "mesh.npz")
    scene, sky = folder / "lit.xml", folder / "sky.xml"
    scene.write_text(_LIT)
    sky.write_text(_LIT.replace("</scene>", '<emitter type="sunsky"/></scene>'))
    for path in (scene, sky):
        sp.precompute(path, bandlimit=2, samples=16).save(path.with_suffix(".npz"))
    sp.capture(scene, bandlimit=2, samples=4).save(folder / "film.npz")


def _try_npz(folder: Path, seeds: Path, random: Random) -> None:
    """Read transfer that is not compressed, and use it."""
    source = random.choice(sorted(seeds.glob("*.npz")))
    path = folder / "damaged.npz"
    path.write_bytes(npz_files.mutate(source.read_bytes(), random))
    transfer = sp.load_transfer(path)
    repr(transfer)
    lighting = np.ones((3, (transfer.bandlimit + 1) ** 2))
    assert np.isfinite(sp.relight(transfer, lighting)).all()
    if random.randrange(10) == 0:
        sp.compress(transfer, terms=4, clusters=3, coding="float32").save(folder / "again.prt")
        sp.load(folder / "again.prt")


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
    with patch.object(direct, "_RAYS_PER_BLOCK", 1 << 12):  # of small blocks there are some
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
    (blocks,) = (folder / "cache").glob("*.blocks")
    journals.damage(blocks, random)
    os.environ["SLEPIAN_PRT_CACHE"] = str(folder / "cache")
    assert _arrays(_job()) == _expected


KINDS = {
    "prt": Kind(_prepare_prt, _try_prt),
    "npz": Kind(_prepare_npz, _try_npz),
    "meshes": Kind(meshes.write_seeds, _try_mesh),
    "maps": Kind(lambda folder: _write(maps.seeds(), folder), _try_map),
    "journals": Kind(_prepare_journals, _try_journal),
    "scenes": Kind(lambda folder: _write(scenes.seeds(), folder), _try_scene),
}
