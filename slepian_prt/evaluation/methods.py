"""The ways to compress that a comparison holds against each other; a new one is one more entry of ``METHODS``."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.bases import BASES, CurveStyle
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.principal_components import iterate_clusters
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import USUAL_TERMS, compress
from slepian_prt.compression.terms_sweep import compress_to_terms
from slepian_prt.errors import UserError
from slepian_prt.evaluation.baselines import D3DX_TERMS, d3dx_transfer, haar_transfer
from slepian_prt.evaluation.hemispherical_transfer import hemispherical_transfer
from slepian_prt.lighting.spectrum import measured_prior
from slepian_prt.relighting.relight import relight
from slepian_prt.transport.transfer import Transfer

# Numbers of functions, unless others are asked for.
DEFAULT_TERMS = (4, 9, 16, 25, 36)

# Of the run that costs are counted in.
COST_TERMS = 16

# Tolerances of the methods that are also compared coded.
_TOLERANCES = (0.2, 0.1, 0.05, 0.02)


class Relightable(Protocol):
    """What other methods than ours make of transfer vectors."""

    @property
    def bytes_per_vertex(self) -> float:
        """Everything counted."""

    def reconstruct(self) -> NDArray[np.float32]:
        """(V, channels, (L+1)²) transfer vectors."""

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""


@dataclass(frozen=True)
class Workload:
    """What all methods of a comparison compress.

    Attributes
    ----------
    transfer : Transfer
    grouping : Grouping
    lighting : sequence of (3, (L+1)²)
        The maps of the comparison.
    terms : sequence of int
        Numbers of functions.
    report : callable
        Given the name of each step as it begins.
    tolerances : sequence of float
        Of the methods that are also compared coded.
    """

    transfer: Transfer
    grouping: Grouping
    lighting: Sequence[NDArray]
    terms: Sequence[int]
    report: Callable[[str], None]
    tolerances: Sequence[float] = _TOLERANCES


@dataclass(frozen=True)
class MethodRun:
    """One method with one setting.

    Attributes
    ----------
    method : str
    coding : str
    terms : float
        Mean number of functions.
    wanted_terms : int or None
        Number of functions that was asked for, if one was.
    transfer : CompressedTransfer or Relightable
    seconds : float
        That compression took.
    """

    method: str
    coding: str
    terms: float
    wanted_terms: int | None
    transfer: CompressedTransfer | Relightable
    seconds: float

    @property
    def compressed(self) -> CompressedTransfer | None:
        """The transfer if it is of our own kind, which knows what error to expect."""
        return self.transfer if isinstance(self.transfer, CompressedTransfer) else None

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""
        if isinstance(self.transfer, CompressedTransfer):
            return relight(self.transfer, lighting)
        return self.transfer.radiance(lighting)


@dataclass(frozen=True)
class Method:
    """What comparisons know of a method by its name.

    Attributes
    ----------
    description : str
        Half a sentence, for reports.
    style : CurveStyle
    run : callable
        Compresses a workload with every setting.
    cost : float
        Time of all its runs with `DEFAULT_TERMS`, in units of one of spherical harmonics with `COST_TERMS`: processor
        time on 33,000 vertices at L = 10, and roughly so on other meshes.
    parts : tuple of tuple of float
        Tolerances that it is coded to; those together whose runs have something in common.
    """

    description: str
    style: CurveStyle
    run: Callable[[Workload], Iterator[MethodRun]]
    cost: float
    parts: tuple[tuple[float, ...], ...] = ()


def check_methods(methods: Sequence[str]) -> None:
    """Raise UserError on an unknown method."""
    for method in methods:
        if method == "none":
            raise UserError("basis none is full SH, which every comparison shows; leave it out")
        if method not in METHODS:
            raise UserError(f"basis must be one of {', '.join(METHODS)}, not {method!r}")


def run_methods(methods: Sequence[str], work: Workload) -> Iterator[MethodRun]:
    """Every method with every number of terms, some coded to every tolerance, and full SH last."""
    for method in methods:
        yield from METHODS[method].run(work)
    yield from FULL_SH.run(work)


class Part(NamedTuple):
    """Runs of a method that do not depend on its others.

    Attributes
    ----------
    method : str
    terms : tuple of int
    tolerances : tuple of float
    """

    method: str
    terms: tuple[int, ...]
    tolerances: tuple[float, ...]

    def run(self, work: Workload) -> Iterator[MethodRun]:
        """Its runs of a workload."""
        method = FULL_SH if self.method == "none" else METHODS[self.method]
        return method.run(replace(work, terms=self.terms, tolerances=self.tolerances))


def parts_of(methods: Sequence[str], terms: Sequence[int]) -> list[Part]:
    """All runs of `run_methods`, in its order."""
    parts = []
    for method in methods:
        parts.append(Part(method, tuple(terms), ()))
        parts += [Part(method, (), tolerances) for tolerances in METHODS[method].parts]
    return [*parts, Part("none", (), ())]


# --- How each is run -------------------------------------------------------------------------------------------------


def _linear(
    name: str, *, refine: bool | None = None, prior_of_maps: bool = False, coded: bool = False
) -> Callable[[Workload], Iterator[MethodRun]]:
    """The basis that ``name`` begins with, cut to numbers of terms and, if ``coded``, rounded to tolerances too."""
    basis = name.partition("+")[0]

    def run(work: Workload) -> Iterator[MethodRun]:
        bandlimit = work.transfer.bandlimit
        prior = measured_prior(work.lighting, bandlimit, "the maps") if prior_of_maps else None
        settings = CompressionSettings(basis=basis, coding="float16", light_prior=prior, refine=refine)
        packs: Iterator[CompressedTransfer]
        if basis == "cpca":
            packs = (
                compress(work.transfer, **{**vars(settings), "terms": k, "clusters": work.grouping}) for k in work.terms
            )
        else:
            packs = compress_to_terms(work.transfer, settings, work.grouping, work.terms)
        for k in work.terms:
            work.report(f"{name}, {k} terms")
            yield _run_of(name, next(packs), wanted_terms=k)
        for tolerance in work.tolerances if coded else ():
            work.report(f"{name}, coded to {tolerance:g}")
            packed = compress(
                work.transfer, basis, tolerance=tolerance, clusters=work.grouping, light_prior=prior, refine=refine
            )
            yield _run_of(name, packed)

    return run


def _cpca(work: Workload) -> Iterator[MethodRun]:
    """Clusters are iterated once for all tolerances, and that time counts each time."""
    yield from _linear("cpca")(work)
    if not work.tolerances:
        return
    begin = time.perf_counter()
    axes, vectors = work.transfer.axes, work.transfer.vectors
    iterated = iterate_clusters(work.grouping.clusters, axes, vectors, USUAL_TERMS, work.report)
    seconds = time.perf_counter() - begin
    for tolerance in work.tolerances:
        work.report(f"cpca, coded to {tolerance:g}")
        packed = compress(work.transfer, "pca", tolerance=tolerance, clusters=iterated)
        yield _run_of("cpca", packed, seconds=seconds)


def _haar(work: Workload) -> Iterator[MethodRun]:
    for k in work.terms:
        work.report(f"haar, {k} terms")
        begin = time.perf_counter()
        wavelets = haar_transfer(work.transfer.vectors, k, work.transfer.mesh.albedo)
        yield MethodRun("haar", "8 bits", k, k, wavelets, time.perf_counter() - begin)


def _hsh(work: Workload) -> Iterator[MethodRun]:
    """Numbers of terms that have the same whole degrees are one run: that of the one that comparisons show first."""
    nearest: dict[int, int] = {}
    for k in sorted(work.terms, key=lambda k: abs(k - COST_TERMS)):
        nearest.setdefault(math.isqrt(k), k)
    for k in (k for k in dict.fromkeys(work.terms) if k in nearest.values()):
        work.report(f"hsh, {k} terms")
        begin = time.perf_counter()
        held = hemispherical_transfer(work.transfer, k)
        yield MethodRun("hsh", "float16", held.terms, k, held, time.perf_counter() - begin)


def _d3dx(work: Workload) -> Iterator[MethodRun]:
    work.report("d3dx")
    begin = time.perf_counter()
    padded = d3dx_transfer(work.transfer, work.grouping)
    yield MethodRun("d3dx", "float16", D3DX_TERMS, None, padded, time.perf_counter() - begin)


def _full_sh(work: Workload) -> Iterator[MethodRun]:
    work.report("full SH")
    yield _run_of("none", compress(work.transfer, "none", coding="float16"))


def _run_of(
    method: str, packed: CompressedTransfer, *, wanted_terms: int | None = None, seconds: float = 0.0
) -> MethodRun:
    """A run of our own compression, which took ``seconds`` beside what the transfer itself says."""
    return MethodRun(method, packed.coding, packed.terms, wanted_terms, packed, seconds + packed.seconds["compress"])


# --- The methods -----------------------------------------------------------------------------------------------------

# Bases that are run otherwise than `_linear` does.
_EACH = tuple((tolerance,) for tolerance in _TOLERANCES)
_PARTS = {"adapted": _EACH, "cpca": (_TOLERANCES,)}
_RUNS = {"adapted": _linear("adapted", coded=True), "cpca": _cpca}

# What answers the question what compression costs: this package's basis, the paper's, none at all, and one that has to
# see all vectors. All methods together take about five times as long.
DEFAULT_METHODS = ("adapted", "slepian", "sh", "pca")

# Of the bases by themselves, see `Method.cost`.
_COSTS = {
    "adapted": 29.0, "transport": 6.0, "slepian": 6.5, "incident": 5.0, "sh": 5.0, "direct": 5.5, "pca": 3.0,
    "cpca": 68.0,
}  # fmt: skip

# Other ways to use a basis, by its name.
_VARIANTS = {
    "adapted": {
        "adapted+light": Method(
            "adapted, made for the mean spectrum of the maps compared here: the relit error counts",
            CurveStyle("#D55E00", "*", "--"),
            _linear("adapted+light", prior_of_maps=True, coded=True),
            cost=29.0,
            parts=_EACH,
        ),
        "adapted+pca": Method(
            "principal axes inside nearly complete adapted coefficients of each cap, which are stored",
            CurveStyle("#D55E00", "s", "-."),
            _linear("adapted+pca", refine=True),
            cost=30.0,
        ),
    }
}


def _methods_of_bases() -> Iterator[tuple[str, Method]]:
    """Every basis by itself, and its variants after it."""
    for name, basis in BASES.items():
        run = _RUNS.get(name) or _linear(name)
        yield name, Method(basis.description, basis.style, run, _COSTS[name], _PARTS.get(name, ()))
        yield from _VARIANTS.get(name, {}).items()


METHODS = {
    **dict(_methods_of_bases()),
    "haar": Method(
        "the largest Haar wavelets of each vertex on a cube (Ng 2003), 8 bits each and their places",
        CurveStyle("#7F7F7F", "p", "--"),
        _haar,
        cost=5.5,
    ),
    "hsh": Method(
        "hemispherical harmonics about each vertex's own normal (Gautron 2004), into whose frame all light is turned",
        CurveStyle("#5E3C99", "d", "-"),
        _hsh,
        cost=25.0,
    ),
    "d3dx": Method(
        "what Direct3D's library recommends: degrees up to 5, cpca with 24 terms",
        CurveStyle("#000000", "h", ""),
        _d3dx,
        cost=4.0,
    ),
}

# Every comparison has this too, under the name "none".
FULL_SH = Method("all spherical harmonics, nothing compressed", CurveStyle("#222222", "+", ""), _full_sh, cost=1.0)
