"""Which light made this picture? Inverse rendering with the integrator; see ``scripts/recover_lighting``.

The picture is drawn by Mitsuba's own ``direct`` under a map, its background hidden. The unknowns are spherical-harmonic
coefficients of the light; an ``envmap`` made of them lights the model through the integrator, and gradients of the
difference between the pictures go back through image, transfer and map to the coefficients.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.renderer.variants import imported_mitsuba, prepare_llvm
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.settings import TransportSettings

ROOT = Path(__file__).parent.parent
DEGREE, BANDLIMIT = 5, 10
WIDTH, SAMPLES, STEPS = 160, 16, 60
MAP_ROWS = 65
# Belief that light falls with the degree, against what one picture does not show: the light from behind.
PRIOR = 2e-6


def main(mesh: Path, environment: Path) -> None:
    prepare_llvm()
    mi = imported_mitsuba()
    mi.set_variant("llvm_ad_rgb")
    import drjit as dr

    sp.register()
    rows, columns = MAP_ROWS, 2 * MAP_ROWS
    v, u = np.meshgrid(np.pi * np.arange(rows) / (rows - 1), 2 * np.pi * (np.arange(-1, columns + 1) + 0.5) / columns,
                       indexing="ij")  # fmt: skip
    towards = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1)
    harmonics = sp.real_sh(DEGREE, towards.reshape(-1, 3)).astype(np.float32)

    def texels_of(light: np.ndarray) -> np.ndarray:
        return (harmonics @ light.T).reshape(rows, columns + 2, 3).astype(np.float32)

    with tempfile.TemporaryDirectory() as folder:
        transfer = Path(folder) / "transfer.prt"
        compress_scene(str(mesh), CompressionSettings(), TransportSettings(BANDLIMIT, 1024)).save(transfer)
        target = draw_target(mi, mesh, environment)
        scene = mi.load_dict({
            "type": "scene", **model(mi, mesh),
            "emitter": {"type": "envmap", "bitmap": mi.Bitmap(np.ones((rows, columns, 3), np.float32))},
            "integrator": {"type": "slepian_prt", "transfer": str(transfer), "hide_emitters": True},
        })  # fmt: skip
    parameters = mi.traverse(scene)
    wanted = mi.TensorXf(target)
    scale = float(np.mean(target**2))
    size = (DEGREE + 1) ** 2
    weights = PRIOR * (degrees(DEGREE) + 1.0) ** 2
    brightness = float(np.linalg.norm(target)) / np.sqrt(target.size)

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        light = flat.reshape(3, size) * brightness
        data = mi.TensorXf(texels_of(light))
        dr.enable_grad(data)
        parameters["emitter.data"] = data
        parameters.update()
        image = mi.render(scene, parameters, spp=SAMPLES, seed=1, seed_grad=2)
        difference = dr.mean(dr.square(image - wanted), axis=None) / scale
        dr.backward(difference)
        gradient = np.array(dr.grad(data)).reshape(-1, 3).T @ harmonics * brightness
        value = float(difference.array[0]) + float(np.sum(weights * flat.reshape(3, size) ** 2))
        return value, (gradient + 2.0 * weights * flat.reshape(3, size)).ravel().astype(np.float64)

    start = np.zeros(3 * size)
    start[::size] = 3.5
    begin = time.perf_counter()
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": STEPS, "ftol": 1e-7})
    seconds = time.perf_counter() - begin
    light = found.x.reshape(3, size) * brightness
    parameters["emitter.data"] = mi.TensorXf(texels_of(light))
    parameters.update()
    again = mi.render(scene, spp=64).numpy()
    truth = sp.project_environment(environment, DEGREE)
    error = np.linalg.norm(again - target) / np.linalg.norm(target)
    upto = [slice((l + 1) ** 2) for l in (1, 2, DEGREE)]
    off = [np.linalg.norm((light - truth)[:, part]) / np.linalg.norm(truth[:, part]) for part in upto]
    print(f"{found.nfev} pictures with gradients in {seconds:.0f} s; the picture is met to {error:.1%}")
    print(f"light off by {off[0]:.1%} up to degree 1, {off[1]:.1%} up to 2, {off[2]:.1%} up to {DEGREE}")
    show(target, again, texels_of(truth)[:, 1:-1], texels_of(light)[:, 1:-1])


def model(mi: object, mesh: Path) -> dict[str, object]:
    """The mesh, white, and a camera that frames it."""
    loaded = sp.read_mesh(mesh)
    low, high = loaded.positions.min(axis=0), loaded.positions.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    eye = middle + size * np.array([0.4, 0.2, 1.15])
    return {
        "mesh": {"type": mesh.suffix[1:], "filename": str(mesh),
                 "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}},
        "sensor": {
            "type": "perspective", "fov": 39,
            "to_world": mi.ScalarTransform4f().look_at(eye.tolist(), middle.tolist(), [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": WIDTH, "pixel_format": "rgb",
                     "rfilter": {"type": "box"}},
        },
    }  # fmt: skip


def draw_target(mi: object, mesh: Path, environment: Path) -> np.ndarray:
    texels = sp.read_environment(environment).texels
    scene = mi.load_dict(
        {"type": "scene", **model(mi, mesh), "emitter": {"type": "envmap", "bitmap": mi.Bitmap(texels)}}
    )
    return mi.render(scene, integrator=mi.load_dict({"type": "direct", "hide_emitters": True}), spp=1024).numpy()


def show(target: np.ndarray, again: np.ndarray, truth: np.ndarray, found: np.ndarray) -> None:
    def tone(linear: np.ndarray, level: float) -> np.ndarray:
        return np.clip(np.maximum(linear, 0.0) / level, 0.0, 1.0) ** (1 / 2.2)

    plt.rcParams.update({"font.size": 11})
    figure, axes = plt.subplots(1, 4, figsize=(15, 3.4), width_ratios=[1, 1, 1.8, 1.8], layout="constrained")
    bright, sky = np.quantile(target, 0.99), np.quantile(truth, 0.98)
    titles = (
        "given: one picture",
        "relit under the light found",
        f"the map to degree {DEGREE}",
        "the light found",
    )
    levels = (bright, bright, sky, sky)
    for axis, image, title, level in zip(axes, (target, again, truth, found), titles, levels, strict=True):
        axis.imshow(tone(image, level))
        axis.set_title(title, fontsize=11)
        axis.axis("off")
    path = ROOT / "docs" / "figures" / "recovered.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    print("docs/figures/recovered.png")


if __name__ == "__main__":
    data = Path(os.environ.get("SLEPIAN_PRT_DATA", ""))
    has_data = (data / "meshes" / "skull.ply").is_file()
    defaults = (
        [data / "meshes" / "skull.ply", data / "environments" / "courtyard.exr"]
        if has_data
        else [ROOT / "scenes" / "knot.ply", ROOT / "scenes" / "sky.exr"]
    )
    given = [Path(argument) for argument in sys.argv[1:3]]
    main(*(given + defaults[len(given) :]))
