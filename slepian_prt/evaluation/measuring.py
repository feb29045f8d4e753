"""What is measured of each method: errors, bytes, seconds and pictures."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slepian_prt.evaluation.comparison import MethodResult, View
from slepian_prt.evaluation.methods import MethodRun
from slepian_prt.evaluation.metrics import relative_rms, seam
from slepian_prt.relighting.drawing.camera import Camera
from slepian_prt.transport.transfer import Transfer

_RELIGHT_RUNS = 3


class Measured(NamedTuple):
    """Some methods, measured.

    Attributes
    ----------
    results : tuple of MethodResult
    lossy : dict of str to MethodRun
        Of the first method, by coding: what the ladder ends with.
    views : list of View
        With the pictures of every method.
    """

    results: tuple[MethodResult, ...]
    lossy: dict[str, MethodRun]
    views: list[View]


def measure_methods(
    runs: Iterable[MethodRun], first: str, transfer: Transfer, views: list[View], camera: Camera, pictured_terms: int
) -> Measured:
    """Measure runs as they come.

    Parameters
    ----------
    runs : iterable of MethodRun
    first : str
        The method that the ladder is about.
    transfer : Transfer
        What was compressed.
    views : list of View
    camera : Camera
    pictured_terms : int
        Number of functions that pictures are drawn of.
    """
    results: list[MethodResult] = []
    lossy: dict[str, MethodRun] = {}
    for run in runs:
        results.append(_measure(run, transfer, views, camera))
        pictured = run.wanted_terms == pictured_terms
        if run.method == first and (pictured or run.coding == "coded"):
            lossy[run.coding] = run  # of the coded ones the last, which is the most exact
        if pictured:
            views = [_with_picture(view, run, camera) for view in views]
    return Measured(tuple(results), lossy, views)


def _with_picture(view: View, run: MethodRun, camera: Camera) -> View:
    picture = camera.picture(run.radiance(view.lighting))
    return replace(view, compressed={**view.compressed, run.method: picture})


def _measure(run: MethodRun, transfer: Transfer, views: Sequence[View], camera: Camera) -> MethodResult:
    """Errors, bytes and seconds of one run."""
    relit_error, image_error, predicted, times, seams = {}, {}, {}, [], []
    for view in views:
        radiance = run.radiance(view.lighting)  # the first call prepares the functions
        for _ in range(_RELIGHT_RUNS):
            begin = time.perf_counter()
            radiance = run.radiance(view.lighting)
            times.append(time.perf_counter() - begin)
        name = view.environment.name
        relit_error[name] = relative_rms(radiance, view.radiance)
        image_error[name] = relative_rms(camera.picture(radiance).radiance, view.reference.picture.radiance)
        if run.compressed is not None:
            predicted[name] = run.compressed.predicted_relit_error(view.lighting)
            seams.append(seam(radiance, view.radiance, transfer.mesh.faces, run.compressed.clusters.index))
    across, within = np.mean(seams, axis=0).tolist() if seams else (None, None)
    return MethodResult(
        run.method,
        run.coding,
        run.terms,
        run.transfer.bytes_per_vertex,
        relative_rms(run.transfer.reconstruct(), transfer.vectors),
        None if run.compressed is None else run.compressed.predicted_error,
        relit_error,
        predicted,
        image_error,
        across,
        within,
        run.seconds,
        float(np.median(times)),
    )
