"""Other tools' own code, brought into a temporary folder, on each harmonic of ours as they have it."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import slepian_prt as sp

DIRECTIONS = np.random.default_rng(0).normal(size=(200, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)

# Where sources are cloned from, by the names of their folders.
REPOSITORIES = {
    "PIFu": "https://github.com/shunsukesaito/PIFu",
    "DECA": "https://github.com/yfeng95/DECA",
    "spherical-harmonics": "https://github.com/google/spherical-harmonics",
    "eigen": "https://gitlab.com/libeigen/eigen.git",
    "gaussian-splatting": "https://github.com/graphdeco-inria/gaussian-splatting",
}


class Missing(Exception):
    """Code that cannot be had here, and why."""


@dataclass(frozen=True)
class Workshop:
    """Where code is brought to.

    Attributes
    ----------
    folder : Path
        Emptied at the end.
    sources : Path or None
        Of checkouts that are there already.
    """

    folder: Path
    sources: Path | None

    def checkout(self, name: str) -> Path:
        """Folder of a repository, cloned if it is not there."""
        for folder in (self.sources, self.folder):
            if folder is not None and (folder / name).is_dir():
                return folder / name
        self.run("git", "clone", "--quiet", "--depth", "1", REPOSITORIES[name], str(self.folder / name))
        return self.folder / name

    def package(self, name: str) -> None:
        """Make a package of PyPI importable."""
        target = self.folder / "packages"
        self.run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(target), name)
        if str(target) not in sys.path:
            sys.path.append(str(target))

    def run(self, *command: str, given: str = "") -> str:
        """What a command prints."""
        try:
            done = subprocess.run(
                command, input=given, capture_output=True, text=True, cwd=self.folder, timeout=600, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise Missing(f"{command[0]}: {error}") from None
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "no reason").splitlines()[-1]
            raise Missing(f"{' '.join(command[:3])} failed ({said})")
        return done.stdout


def _each(target: str, bandlimit: int, evaluate: Callable[[NDArray], NDArray], quantity: str | None = None) -> float:
    """Greatest difference over all harmonics of ours, in red, green and blue."""
    worst = 0.0
    for i in range((bandlimit + 1) ** 2):
        ours = np.zeros((3, (bandlimit + 1) ** 2))
        ours[:, i] = (1.0, 0.5, 0.25)
        theirs = evaluate(sp.convert_sh(ours, target=target, quantity=quantity))
        worst = max(worst, float(np.abs(theirs - sp.real_sh(bandlimit, DIRECTIONS) @ ours.T).max()))
    return worst


def shtools(_workshop: Workshop) -> float:
    import pyshtools

    latitude = np.degrees(np.arcsin(DIRECTIONS[:, 2]))
    longitude = np.degrees(np.arctan2(DIRECTIONS[:, 1], DIRECTIONS[:, 0]))

    def evaluate(coefficients: NDArray) -> NDArray:
        colours = [pyshtools.SHCoeffs.from_array(one, normalization="4pi", csphase=1) for one in coefficients]
        return np.stack([one.expand(lat=latitude, lon=longitude) for one in colours], axis=1)

    return _each("shtools", 10, evaluate)


def sphericart(workshop: Workshop) -> float:
    workshop.package("sphericart")
    harmonics = importlib.import_module("sphericart").SphericalHarmonics(10)
    return _each("sphericart", 10, lambda coefficients: np.asarray(harmonics.compute(DIRECTIONS)) @ coefficients.T)


_THREE = """
import { SphericalHarmonics3, LightProbe, Vector3 } from 'three';
const { probes, directions } = JSON.parse((await import('node:fs')).readFileSync(0, 'utf8'));
console.log(JSON.stringify(probes.map((numbers) => {
    const probe = new LightProbe(new SphericalHarmonics3().fromArray(numbers));
    return directions.map((d) => probe.sh.getAt(new Vector3(...d), new Vector3()).toArray());
})));
"""


def three(workshop: Workshop) -> float:
    workshop.run("npm", "install", "--silent", "--prefix", str(workshop.folder), "three")
    (workshop.folder / "three.mjs").write_text(_THREE)

    def evaluate(coefficients: NDArray) -> NDArray:
        given = json.dumps({"probes": [coefficients.ravel().tolist()], "directions": DIRECTIONS.tolist()})
        return np.array(json.loads(workshop.run("node", "three.mjs", given=given))[0])

    return _each("three", 2, evaluate)


_GOOGLE = """
#include <cstdio>
#include "sh/spherical_harmonics.h"
int main() {
  double x, y, z;
  while (std::scanf("%lf %lf %lf", &x, &y, &z) == 3)
    for (int l = 0; l <= 6; l++)
      for (int m = -l; m <= l; m++)
        std::printf("%.17g\\n", sh::EvalSH(l, m, Eigen::Vector3d(x, y, z)));
}
"""


def google(workshop: Workshop) -> float:
    """Its functions up to degree 4 have constants of six digits."""
    source, eigen = workshop.checkout("spherical-harmonics"), workshop.checkout("eigen")
    (workshop.folder / "google.cc").write_text(_GOOGLE)
    library = str(source / "sh" / "spherical_harmonics.cc")
    workshop.run("g++", "-O1", "-w", f"-I{source}", f"-I{eigen}", "google.cc", library, "-o", "google")
    given = "\n".join(" ".join(map(repr, direction)) for direction in DIRECTIONS.tolist())
    basis = np.array(workshop.run(str(workshop.folder / "google"), given=given).split(), dtype=float).reshape(-1, 49)
    return _each("google", 6, lambda coefficients: basis @ coefficients.T)


def prt_util(workshop: Workshop) -> types.ModuleType:
    """PIFu's module, without what is no longer in NumPy and SciPy: ``np.float``, and an import that it does not use."""
    text = (workshop.checkout("PIFu") / "apps" / "prt_util.py").read_text()
    text = text.replace("from scipy.special import sph_harm\n", "").replace("np.float)", "float)")
    text = text.replace("from tqdm import tqdm\n", "tqdm = lambda steps: steps\n")
    module = types.ModuleType("prt_util")
    exec(compile(text, "prt_util.py", "exec"), module.__dict__)
    return module


def pifu(workshop: Workshop) -> float:
    """Light from its samples (-sin θ cos φ, -sin θ sin φ, cos θ), by ``getSHCoeffs`` of the angles."""
    module = prt_util(workshop)
    theta = np.arccos(DIRECTIONS[:, 2])
    phi = np.arctan2(-DIRECTIONS[:, 1], -DIRECTIONS[:, 0])
    basis = module.getSHCoeffs(4, phi, theta)
    return _each("pifu", 4, lambda coefficients: basis @ coefficients, "lighting")


class _Torch(types.ModuleType):
    """As much of torch as these functions of other tools call, in NumPy."""

    def __init__(self) -> None:
        super().__init__("torch")
        self.stack = lambda arrays, dim: np.stack(arrays, axis=dim)
        self.sum = lambda array, dim: np.sum(array, axis=dim)
        self.tensor = lambda numbers: types.SimpleNamespace(float=lambda: np.array(numbers))


def deca(workshop: Workshop) -> float:
    """``add_SHlight`` of white surfaces, against radiance of unblocked receivers."""
    text = (workshop.checkout("DECA") / "decalib" / "utils" / "renderer.py").read_text()
    tree = ast.parse(text)
    renderer = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "SRenderY")
    methods = {n.name: n for n in renderer.body if isinstance(n, ast.FunctionDef)}
    factor = next(
        n for n in ast.walk(methods["__init__"])
        if isinstance(n, ast.Assign) and getattr(n.targets[0], "id", "") == "constant_factor"
    )  # fmt: skip
    names: dict = {"np": np, "torch": _Torch(), "pi": np.pi}
    exec(compile(ast.Module([factor, methods["add_SHlight"]], []), "renderer.py", "exec"), names)
    held = types.SimpleNamespace(constant_factor=names["constant_factor"])
    normals = DIRECTIONS.T[None, :, :, None]  # a picture, one pixel wide
    lobe = np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5])

    def evaluate(coefficients: NDArray) -> NDArray:
        return np.asarray(names["add_SHlight"](held, normals, coefficients[None])[0, :, :, 0].T)

    worst = 0.0
    for i in range(9):
        ours = np.zeros((3, 9))
        ours[:, i] = (1.0, 0.5, 0.25)
        theirs = evaluate(sp.convert_sh(ours, target="deca"))
        worst = max(worst, float(np.abs(theirs - sp.real_sh(2, DIRECTIONS) @ (ours * lobe).T).max()))
    return worst


def splats(workshop: Workshop) -> float:
    """``eval_sh`` and ``+ 0.5``, of properties in the order of ``load_ply``."""
    text = (workshop.checkout("gaussian-splatting") / "utils" / "sh_utils.py").read_text()
    names: dict = {}
    exec(compile(text.replace("import torch\n", ""), "sh_utils.py", "exec"), names)

    def evaluate(properties: NDArray) -> NDArray:
        rest = properties[3:].reshape(3, -1)  # as load_ply: (F, coefficients except DC)
        features = np.concatenate([properties[:3, None], rest], axis=1)
        return np.stack([names["eval_sh"](3, features, d) for d in DIRECTIONS]) + 0.5

    return _each("gaussian-splatting", 3, evaluate)


# Who is compared, and what rounding and the digits of their constants leave.
TOOLS: dict[str, tuple[Callable[[Workshop], float], float]] = {
    "shtools": (shtools, 1e-12),
    "sphericart": (sphericart, 1e-12),
    "three": (three, 2e-6),
    "google": (google, 1e-5),
    "pifu": (pifu, 1e-12),
    "deca": (deca, 1e-12),
    "gaussian-splatting": (splats, 1e-12),
}
