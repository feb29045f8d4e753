"""Whether coherence of neighbouring vertices makes up for rays, as Lessig & Fiume (Sec. 4) expect: hardly."""

from __future__ import annotations

from numpy.typing import NDArray
from paper.coherence import lasting_part, shared_by_neighbours, smoothed_error
from paper.models import models

import slepian_prt as sp
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.terms_sweep import compress_to_terms
from slepian_prt.evaluation.metrics import relative_rms

BANDLIMIT, REFERENCE = 10, 8192
RAYS = (48, 64, 128, 256)
SEEDS = 3
TERMS = (16, 36, 64)
BASES = ("slepian", "adapted")


def sampling() -> None:
    """Error of few rays as they are, smoothed along the surface, and projected on the first functions of caps."""
    terms = ", ".join(str(k) for k in TERMS)
    heads = ("raw", "one ring", "two rings", *(f"on {terms} of `{basis}`" for basis in BASES))
    print("| model | rays | " + " | ".join(heads) + " | lasts | shared |")
    print("| --- " * (4 + len(heads)) + "|")
    for model in models("skull"):
        exact = sp.precompute(model.mesh, BANDLIMIT, REFERENCE, seed=1000).vectors[:, 0]
        for rays in RAYS:
            traced = [sp.precompute(model.mesh, BANDLIMIT, rays, seed=seed) for seed in range(SEEDS)]
            vectors, neighbours = traced[0].vectors[:, 0], traced[0].mesh.receivers.neighbours
            errors = [each.vectors[:, 0] - exact for each in traced]
            raw = relative_rms(vectors, exact)
            rings = [smoothed_error(vectors, exact, neighbours, count) for count in (1, 2)]
            told = [f"{error:.2%} ({error / raw - 1:+.0%})" for error in rings]
            told += [_projected(traced[0], exact, basis) for basis in BASES]
            lasts, shared = lasting_part(errors), shared_by_neighbours(errors[0], neighbours)
            cells = " | ".join(told)
            name = model.name.split(",")[0]
            print(f"| {name} | {rays} | {raw:.2%} | {cells} | {lasts:.0%} | {shared:.2f} |", flush=True)


def _projected(transfer: sp.Transfer, exact: NDArray, basis: str) -> str:
    """Errors of vectors projected on the first functions of their caps."""
    settings = CompressionSettings(basis=basis, coding="float16")
    packs = compress_to_terms(transfer, settings, group_transfer(settings, transfer), TERMS)
    return ", ".join(f"{relative_rms(packed.reconstruct(), exact):.1%}" for packed in packs)
