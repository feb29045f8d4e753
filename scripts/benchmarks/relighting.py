"""Relighting beside full SH, a copy of the same bytes, and the naive projection of a map."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from benchmarks.common import DRAGONS, data_folder, line, median_seconds

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.texel_projection import clenshaw_curtis
from slepian_prt.relighting.factors import all_factors
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.transport.settings import TransportSettings

_RUNS = 15


def relighting() -> None:
    """One light and many, from compressed files and full SH; projection of a map; pictures of the integrator."""
    environments = data_folder() / "environments"
    studio = environments / "studio.exr"
    skull = data_folder() / "meshes" / "skull.ply"
    _project(studio)
    for bandlimit in (10, 20):
        for settings, name in ((CompressionSettings(terms=16), "K = 16"), (CompressionSettings(), "default")):
            packed = compress_scene(str(skull), settings, TransportSettings(bandlimit, 1024))
            _relight(f"skull, L = {bandlimit}, {name}", packed, studio)
    _integrator(str(skull), studio)
    dragon = DRAGONS / "dragon_vrip.ply"
    if not dragon.is_file():
        line("dragon", "not here, left out; scripts/fetch_dragons fetches it")
        return
    for settings, name in (
        (CompressionSettings(terms=16), "K = 16"),
        (CompressionSettings(tolerance=0.05), "tolerance 0.05"),
    ):
        packed = compress_scene(str(dragon), settings, TransportSettings(20, 1024))
        _relight(f"dragon of {len(packed.mesh.positions):,} vertices, L = 20, {name}", packed, studio)


def _project(path: Path) -> None:
    texels = read_environment(path).texels
    height = len(texels)
    v, u = np.pi * np.arange(height) / (height - 1), np.pi * (np.arange(2 * height) + 0.5) / height
    v, u = np.meshgrid(v, u, indexing="ij")
    directions = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1).reshape(-1, 3)
    weights = np.repeat(clenshaw_curtis(height - 1) * np.pi / height, 2 * height)
    weighted = (texels.reshape(-1, 3) * weights[:, None]).T

    def naive() -> np.ndarray:
        return weighted @ sp.real_sh(20, directions)

    error = np.abs(sp.project_environment(texels, 20) - naive()).max() / np.abs(naive()).max()
    ours, theirs = median_seconds(lambda: sp.project_environment(texels, 20), _RUNS), median_seconds(naive, 3)
    line("1024x512 map to L = 20, checks included", f"{1e3 * ours:.1f} ms")
    line("  times faster than every harmonic at every texel; largest relative difference",
         f"{theirs / ours:.0f}; {error:.0e}")  # fmt: skip
    line("  the same from the file (.exr, DWAB)",
         f"{1e3 * median_seconds(lambda: sp.project_environment(path, 20), 5):.0f} ms")  # fmt: skip


def _relight(name: str, packed: sp.CompressedTransfer, environment: Path) -> None:
    """Relight from what is read from the file again."""
    with tempfile.TemporaryDirectory() as folder:
        packed.save(Path(folder) / "file.prt")
        packed = sp.load(Path(folder) / "file.prt")
    lighting = sp.project_environment(environment, packed.bandlimit)
    prepare = median_seconds(lambda: transfer_operator(packed), 1)
    numbers = transfer_operator(packed).size
    ours = median_seconds(lambda: sp.relight(packed, lighting), _RUNS)
    before = median_seconds(_cap_by_cap(packed, lighting), _RUNS)
    source, target = (np.full(numbers, value, dtype=np.float32) for value in (0.0, 1.0))
    copy = median_seconds(lambda: np.copyto(target, source), _RUNS)
    count, size = len(packed.mesh.positions), (packed.bandlimit + 1) ** 2
    vectors = np.random.default_rng(0).random((count, size), dtype=np.float32)
    light = lighting.T.astype(np.float32)
    full = median_seconds(lambda: vectors @ light, _RUNS)
    many = np.stack([lighting] * 60)
    batch = median_seconds(lambda: sp.relight(packed, many), 3) / 60
    together = np.concatenate([light] * 60, axis=1)
    full_batch = median_seconds(lambda: vectors @ together, 3) / 60
    line(f"{name}: K; numbers read per vertex", f"{packed.terms:.4g}; {numbers / count:.4g}")
    line("  first light (after loading), prepared in", f"{prepare:.2f} s")
    line("  one light; a copy of the same bytes", f"{1e3 * ours:.2f} ms; {1e3 * copy:.2f} ms, {copy / ours:.2f} of it")
    line("  the same cap by cap, as before", f"{1e3 * before:.2f} ms")
    line("  times faster than full SH; 0.6 M/K", f"{full / ours:.2f}; {0.6 * size / packed.terms:.2f}")
    line("  one of 60 lights at once; full SH likewise", f"{1e3 * batch:.2f} ms; {1e3 * full_batch:.2f} ms")


def _cap_by_cap(packed: sp.CompressedTransfer, lighting: np.ndarray) -> Callable[[], object]:
    """One light by a product for each cap, which goes to its vertices."""
    parts, members = all_factors(packed), packed.clusters.members
    functions = np.concatenate([part.functions for part in parts]).astype(np.float32)[:, 0]
    ends = np.cumsum([len(part.functions) for part in parts])
    light = np.pad(lighting, ((0, 1), (0, 0))).T.astype(np.float32)

    def relight() -> np.ndarray:
        lit = functions @ light
        rows = np.empty((len(packed.mesh.positions), 4), dtype=np.float32)
        for part, vertices, end in zip(parts, members, ends, strict=True):
            product = part.coefficients @ lit[end - len(part.functions) : end]
            rows.view(np.complex128)[vertices] = product.view(np.complex128)
        return rows[:, :3]

    return relight


def _integrator(mesh: str, environment: Path) -> None:
    from slepian_prt.renderer.variants import imported_mitsuba, prepare_llvm

    prepare_llvm()
    mi = imported_mitsuba()
    mi.set_variant("llvm_ad_rgb")
    sp.register()
    with tempfile.TemporaryDirectory() as folder:
        compress_scene(mesh, CompressionSettings(), TransportSettings(10, 1024)).save(Path(folder) / "file.prt")
        scene = mi.load_dict({
            "type": "scene", "emitter": {"type": "envmap", "filename": str(environment)},
            "skull": {"type": "ply", "filename": mesh},
            "integrator": {"type": "slepian_prt", "transfer": str(Path(folder) / "file.prt")},
            "sensor": {
                "type": "perspective", "fov": 30,
                "to_world": mi.ScalarTransform4f().look_at([8, 10, 34], [0, 7, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 512, "height": 512},
            },
        })  # fmt: skip
    parameters = mi.traverse(scene)
    direct = mi.load_dict({"type": "direct"})

    def draw(**options: object) -> None:
        mi.render(scene, spp=16, **options).numpy()

    draw(), draw(integrator=direct)  # compiled
    ours, theirs = median_seconds(draw), median_seconds(lambda: draw(integrator=direct))
    texels = np.array(parameters["emitter.data"])

    def changed() -> None:
        parameters["emitter.data"] = mi.TensorXf(texels * np.float32(1.01))
        parameters.update()
        draw()

    line("integrator, skull, 512 x 512, 16 samples: time of Mitsuba's direct", f"{ours / theirs:.2f}")
    line("  under a new map, its importance sampling by Mitsuba included", f"{median_seconds(changed) / theirs:.2f}")
