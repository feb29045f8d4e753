"""Read other people's models with our readers and with independent ones, and say where they differ.

    scripts/compare_readers FOLDER … [--every N] [--albedo] [--verbose]

Every ply, obj, stl, off, glb and gltf file in the folders is read by `slepian_prt.scene.mesh_files.read_mesh` and by
each other reader that is there, all in processes of their own. Compared are the number of triangles that have an area,
that area, and the box about them. Of each file it says one of

    same       as another reader, and which; also where it agrees with ours once polygons are cut into fans as it does
    differs    from all others, and in what
    refused    and our line; with what the others make of it
    alone      read by ours, and by no other
    fault      a traceback, something printed, a process that died or hangs

and then the counts of each folder and format. With ``--every N``, `slepian-prt precompute` is run on all refused files
and on each Nth of the others: it must end with 0, or with 2 and one line. With ``--albedo``, the mean albedo of simple
glTF files with textures must be, within two per cent, that of 200 000 points, looked up in float64. It exits with 1 if
a file differs or is at fault.

Independent readers, of which any may be missing:

    trimesh    which is installed with this package
    assimp     pip install assimp-py
    three      npm install --prefix downloads three draco3d

Collections that were compared, to be cloned beside: github.com/mikedh/trimesh (models), assimp/assimp (test),
libigl/libigl-tutorial-data, alecjacobson/common-3d-test-models, google/draco (testdata), CesiumGS/obj2gltf,
CesiumGS/gltf-pipeline, mosra/magnum-plugins, playcanvas/engine, donmccurdy/glTF-Transform, KhronosGroup/glTF-Validator,
KhronosGroup/glTF-Sample-Assets, KhronosGroup/glTF-Blender-IO, bevyengine/bevy, syoyo/tinyobjloader, syoyo/tinygltf.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from readers.albedo import mean_albedo
from readers.measures import differences
from readers.others import installed
from readers.workers import Answer, Worker, serve

from slepian_prt.scene.mesh_files import read_mesh

SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf")
NODE_MODULES = Path(__file__).parent.parent / "downloads" / "node_modules"
ALBEDO_TOLERANCE = 0.02
VERDICTS = ("same", "refused", "alone", "differs", "fault")


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    path: Path
    verdict: str
    words: str


def judge(path: Path, ours: Answer, others: dict[str, Answer], cut_as_fans: Callable[[Path], Answer]) -> Row:
    """The verdict on a file."""
    if ours.fault:
        return Row(path, "fault", ours.fault)
    read = {name: answer.measures for name, answer in others.items() if answer.measures and answer.measures.most}
    if ours.measures is None:
        line = ours.refusal.replace(f"{path}: ", "")
        there = ", ".join(f"{name} reads {m.most} triangles" for name, m in read.items())
        return Row(path, "refused", line + (f" [{there}]" if there else " [and so do the others]"))
    found = {name: differences(ours.measures, theirs) for name, theirs in read.items()}
    same = [name for name, what in found.items() if not what]
    other = "; ".join(f"{name}: {what}" for name, what in found.items() if what)
    if same:
        return Row(path, "same", f"as {', '.join(same)}" + (f" (but {other})" if other else ""))
    fans = cut_as_fans(path).measures if found else None
    same = [name for name, theirs in read.items() if fans and not differences(fans, theirs)]
    if same:
        return Row(path, "same", f"as {', '.join(same)} with polygons as fans ({other})")
    if found:
        return Row(path, "differs", other)
    return Row(path, "alone", "; ".join(f"{name}: {answer.refusal or answer.fault}" for name, answer in others.items()))


def find_files(roots: list[Path]) -> list[tuple[Path, Path]]:
    """Mesh files with the root that each is below."""
    found = []
    for root in roots:
        paths = [root] if root.is_file() else sorted(path for path in root.rglob("*") if path.is_file())
        found += [(path, root) for path in paths if path.suffix.lower() in SUFFIXES]
    return found


def precompute(path: Path, seconds: float) -> str:
    """Run the command on a file; what is wrong with how it ends, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "slepian_prt", "precompute", str(path), "-o", f"{folder}/out.prt"]
        command += ["--bandlimit", "2", "--effects", "direct", "--samples", "16"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=seconds)
        except subprocess.TimeoutExpired:
            return f"precompute hangs ({seconds:g} s)"
    lines = done.stderr.strip().splitlines()
    if done.returncode not in (0, 2):
        return f"precompute ends with {done.returncode}: {(lines or [''])[-1][:200]}"
    if any("Warning" in line or "Traceback" in line for line in lines):
        return f"precompute prints {lines[-1][:200]}"
    if done.returncode == 2 and len(lines) != 1:
        return f"precompute refuses in {len(lines)} lines: {lines[:1]}"
    return ""


def albedo(path: Path) -> tuple[str, str]:
    """A verdict on our mean albedo of a file beside an independent one, and words; none on one that is not simple."""
    try:
        expected = mean_albedo(path)
    except (KeyError, OSError):  # an image that is missing, or of another format
        expected = None
    if expected is None:
        return "", ""
    mesh = read_mesh(path)
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ours = areas @ mesh.albedo[mesh.faces].mean(axis=1, dtype=np.float64) / areas.sum()
    apart = float(np.abs(ours - expected).max() / max(expected.max(), 1e-3))
    words = f"albedo {np.round(ours, 4).tolist()}, by points {np.round(expected, 4).tolist()} ({apart:.2%} apart)"
    return ("same" if apart < ALBEDO_TOLERANCE else "differs"), words


def compare(path: Path, number: int, workers: dict[str, Worker], options: argparse.Namespace) -> list[Row]:
    """What there is to say of a file, the verdict on its triangles first."""
    start = time.perf_counter()
    ours = workers["ours"].ask(path)
    seconds = time.perf_counter() - start
    others = {name: worker.ask(path) for name, worker in workers.items() if name not in ("ours", "fans")}
    row = judge(path, ours, others, workers["fans"].ask)
    rows = [row]
    if seconds > 0.5 * options.timeout:
        rows.append(Row(path, "fault", f"takes {seconds:.0f} s"))
    if options.every and row.verdict != "fault" and (row.verdict == "refused" or number % options.every == 0):
        wrong = precompute(path, options.timeout)
        rows += [Row(path, "fault", wrong)] if wrong else []
    if options.albedo and row.verdict == "same" and path.suffix.lower() in (".glb", ".gltf"):
        verdict, words = albedo(path)
        rows += [Row(path, verdict, words)] if verdict else []
    return rows


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--every", type=int, default=0, help="run precompute on each so manieth file, and all refused")
    parser.add_argument("--albedo", action="store_true", help="compare the mean albedo of glTF files with textures")
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds for a file")
    parser.add_argument("--memory", type=float, default=8.0, help="gigabytes for a reader")
    parser.add_argument("--verbose", action="store_true", help="show files that are the same, too")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> int:
    options = read_options()
    if options.serve:
        serve(options.serve)
        return 0
    names = ["ours", *installed(), *(["three"] if (NODE_MODULES / "three").is_dir() else [])]
    workers = {name: Worker(name, options.timeout, options.memory, NODE_MODULES) for name in [*names, "fans"]}
    print(f"Readers: {', '.join(names)}\n")
    counts: Counter[tuple[str, str, str]] = Counter()
    for number, (path, root) in enumerate(find_files(options.folders)):
        rows = compare(path, number, workers, options)
        for row in rows:
            if options.verbose or row.verdict != "same":
                print(f"{row.verdict:8} {path.relative_to(root.parent)}: {row.words}", flush=True)
        worst = max(rows, key=lambda row: VERDICTS.index(row.verdict))
        counts[root.name, path.suffix.lower(), worst.verdict] += 1
    for worker in workers.values():
        worker.stop()
    print("\n" + "".join(f"{word:>9}" for word in VERDICTS))
    for root_name, suffix in sorted({key[:2] for key in counts}):
        row_counts = (counts[root_name, suffix, verdict] for verdict in VERDICTS)
        print("".join(f"{count:9}" for count in row_counts), f" {root_name} {suffix}")
    return int(any(key[2] in ("differs", "fault") for key in counts))


if __name__ == "__main__":
    sys.exit(main())
