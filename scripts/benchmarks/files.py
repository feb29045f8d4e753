"""What files spend on meshes and on all, beside deflate and Draco; seconds to store, to read and to decode."""

from __future__ import annotations

import tempfile
import time
import zlib
from pathlib import Path

import DracoPy
import numpy as np
from benchmarks.common import DRAGONS, data_folder, line, median_seconds
from numpy.typing import NDArray

import slepian_prt as sp
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.decoder import decode_all
from slepian_prt.compression.files import container
from slepian_prt.compression.stored_mesh.stored import StoredMesh, pack_order, read_mesh, store_mesh
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mesh_files import read_mesh as read_source
from slepian_prt.scene.scene import Part

SCANS = ("skull", "nefertiti")
RAYS, TOLERANCES = 1024, (0.05, 0.02)


def files() -> None:
    """Bytes per vertex of meshes and whole files; the time to store and to read a mesh."""
    folder = data_folder() / "meshes"
    scans = [folder / f"{name}.ply" for name in SCANS if (folder / f"{name}.ply").is_file()]
    for path in [*scans, *sorted(DRAGONS.glob("*.ply"), key=lambda path: path.stat().st_size)]:
        _mesh(path)
    for path in scans:
        _whole(path)
    if not scans:
        print("SLEPIAN_PRT_DATA must name the folder of scanned meshes; they are left out")


def _mesh(path: Path) -> None:
    mesh = read_source(path)
    count = len(mesh.positions)
    mesh.receivers  # noqa: B018 (not a part of what is timed)
    single = mesh.positions.astype(np.float32)
    deflated = [_deflated(array) / count for array in (single, mesh.normals.astype(np.float32), mesh.faces)]
    line(
        f"{path.stem}, {count} vertices: deflated float32 positions, normals, int32 faces",
        f"{deflated[0]:.2f} + {deflated[1]:.2f} + {deflated[2]:.2f} bytes per vertex",
    )
    draco = _by_draco(mesh)
    line("  Draco alone, 16 bits, positions and faces", f"{len(draco) / count:.2f} bytes per vertex")
    for exact in (False, True):
        stored = _store(mesh, exact)
        order = _size(dict(pack_order(stored.order, mesh))) / count
        seconds = median_seconds(lambda stored=stored: read_mesh(stored.entry, stored.arrays, "mesh", ()))
        line(
            f"  {'exact' if exact else 'mesh'} part of a file; map back to the source's order",
            f"{_size(stored.arrays, stored.entry) / count:.2f}; {order:.2f} bytes per vertex",
        )
        line("    to read it", f"{1e3 * seconds:.0f} ms")
    line("    Draco alone", f"{1e3 * median_seconds(lambda: DracoPy.decode(draco).faces):.0f} ms")
    line("    to inflate the arrays above", f"{1e3 * _inflating(single, mesh.normals, mesh.faces):.0f} ms")
    line("    to store it", f"{1e3 * median_seconds(lambda: _store(_copy(mesh), False), 3):.0f} ms")


def _whole(path: Path) -> None:
    transfer = sp.precompute(path, bandlimit=10, samples=RAYS)
    for tolerance in TOLERANCES:
        packed = sp.compress(transfer, tolerance=tolerance)
        with tempfile.TemporaryDirectory() as folder:
            packed.save(Path(folder) / "out.prt")
            size = (Path(folder) / "out.prt").stat().st_size
            loading = median_seconds(lambda file=Path(folder) / "out.prt": sp.load(file))
            *seconds, count = _decoding(Path(folder) / "out.prt")
        line(
            f"{path.stem}, {RAYS} rays, tolerance {tolerance}: transfer, mesh, whole file",
            f"{packed.bytes_per_vertex:.2f}, {packed.mesh_bytes_per_vertex:.2f}, "
            f"{packed.file_bytes_per_vertex:.2f} bytes per vertex, {size / 1e6:.3f} MB",
        )
        parts = "; ".join(f"{1e3 * part:.0f} ms" for part in (loading, *seconds))
        line("  to load it; mesh and caps; neighbours; coefficients", parts)
        numbers = np.zeros(count, dtype=np.float32)
        copy = median_seconds(lambda numbers=numbers: numbers.copy())
        rates = (count / part / 1e6 for part in (seconds[2], seconds[1] + seconds[2], copy))
        line("  coefficients decoded; neighbours found, too; copied", "; ".join(f"{rate:.1f} M/s" for rate in rates))


def _decoding(file: Path) -> tuple[float, float, float, int]:
    """Median seconds that the mesh, neighbours and the coefficients of a loaded file take, and how many these are."""
    clocks, count = [], 0
    for _ in range(7):
        packed = sp.load(file)
        clock = [time.perf_counter()]
        members = packed.clusters.members
        clock.append(time.perf_counter())
        surface_of(packed.mesh.receivers).rows(members)
        clock.append(time.perf_counter())
        count = sum(cap.values.size for cap in decode_all(packed))
        clocks.append([*clock, time.perf_counter()])
    mesh, neighbours, coefficients = np.median(np.diff(clocks, axis=1), axis=0)
    return mesh, neighbours, coefficients, count


def _store(mesh: Mesh, exact: bool) -> StoredMesh:
    return store_mesh(mesh, (Part(mesh.name, 0, len(mesh.positions)),), exact=exact)


def _copy(mesh: Mesh) -> Mesh:
    """The same mesh, which nothing is remembered of yet."""
    copy = Mesh(mesh.name, mesh.positions, mesh.normals, mesh.faces, mesh.albedo)
    copy.receivers  # noqa: B018 (as above)
    return copy


def _by_draco(mesh: Mesh) -> bytes:
    step = np.ptp(mesh.positions, axis=0).max() / 65_535
    places = np.rint((mesh.positions - mesh.positions.min(axis=0)) / step).astype(np.uint32)
    return bytes(DracoPy.encode(places, mesh.faces.astype(np.uint32), compression_level=10))


def _size(arrays: dict[str, NDArray], entry: dict | None = None) -> int:
    sizes = container.sizes_of({} if entry is None else {"mesh": entry}, arrays)
    return sum(size for name, size in sizes.items() if entry is not None or name != "manifest.json")


def _deflated(array: NDArray) -> int:
    return len(zlib.compress(np.ascontiguousarray(array).tobytes(), 6))


def _inflating(*arrays: NDArray) -> float:
    packed = [zlib.compress(np.ascontiguousarray(array).tobytes(), 6) for array in arrays]
    return median_seconds(lambda: [zlib.decompress(one) for one in packed])
