"""The pictures of a report: of every stage under one environment, each beside its error."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import numpy as np
import PIL.Image
from numpy.typing import NDArray

from slepian_prt.evaluation.comparison import Comparison, View
from slepian_prt.evaluation.ladder import NO_BANDLIMIT
from slepian_prt.evaluation.metrics import error_map
from slepian_prt.evaluation.plots import percent
from slepian_prt.relighting.drawing.pictures import TRANSPARENT, Finish, Picture, display, exposure, to_srgb

# The end of the colour scale of error maps, relative to the mean luminance.
ERROR_SCALE = 0.25


def draw_view(comparison: Comparison, view: View) -> dict[str, Any]:
    """What the template shows of one environment: all pictures exposed alike, and cropped to what they show."""
    finish = comparison.finish
    reference, size = view.reference.picture, (comparison.transfer.bandlimit + 1) ** 2
    compressed = [
        _panel(view, finish, basis, f"{basis}, {comparison.pictured_terms} functions", picture, view.full, "full SH")
        for basis, picture in view.compressed.items()
    ]
    return {
        "environment": view.environment.name,
        "panels": [
            _panel(view, finish, "reference", "path-traced reference", reference),
            _panel(view, finish, "vertices", NO_BANDLIMIT, view.interpolated, reference, "the reference"),
            _panel(view, finish, "full_sh", f"full SH, {size} functions", view.full, reference, "the reference"),
            *compressed,
        ],
        "noise": view.reference.noise,
        "samples": view.reference.samples,
        "negative": comparison.negative[view.environment.name],
        "clamped": view.environment.clamped,
    }


def _panel(
    view: View,
    finish: Finish,
    file: str,
    title: str,
    picture: Picture,
    against: Picture | None = None,
    name: str = "",
) -> dict[str, Any]:
    """A picture beside its difference from another of that name, or beside the environment map."""
    scale, crop = exposure(view.reference.picture) * finish.factor, _crop(view.reference.picture.alpha)
    shown = display(picture if view.backdrop is None else picture.over(view.backdrop), scale, finish.colour)
    pixels = (shown * 255.0 + 0.5).astype(np.uint8)[crop]
    if against is None:
        error_file, error_png, error_title = "map", _map_png(view), f"the environment map {view.environment.name}"
    else:
        errors = error_map(picture, against)[crop]
        mean = float(np.nanmean(errors)) if np.isfinite(errors).any() else 0.0
        error_file, error_png = f"{file}_error", encode_error_map(errors)
        error_title = f"its difference from {name}, {percent(mean)} on average"
    return {
        "file": file,
        "title": title,
        "png": encode_picture(pixels if finish.background == TRANSPARENT else pixels[..., :3]),
        "error_file": error_file,
        "error_title": error_title,
        "error_png": error_png,
    }


def _map_png(view: View) -> bytes:
    """The environment map, made small, with its centre column the direction -x."""
    texels = view.environment.texels
    down, across = (max(1, n // m) for n, m in zip(texels.shape[:2], (128, 256), strict=True))
    rows, columns = texels.shape[0] // down * down, texels.shape[1] // across * across
    small = texels[:rows, :columns].reshape(rows // down, down, columns // across, across, 3).mean(axis=(1, 3))
    picture = Picture(small, np.ones(small.shape[:2], dtype=np.float32))
    return encode_picture(to_srgb(picture, exposure(picture)))


def _crop(alpha: NDArray) -> tuple[slice, slice]:
    """Rows and columns of what is covered, with a margin."""
    rows, columns = (np.flatnonzero((alpha > 0.0).any(axis=axis)) for axis in (1, 0))
    if rows.size == 0:
        return slice(None), slice(None)
    margin = 6
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )


def encode_picture(image: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None) -> bytes:
    """PNG of an (H, W, 3) or (H, W, 4) picture, or of (H, W) indices into a (256, 3) palette."""
    picture = PIL.Image.fromarray(image)
    if palette is not None:
        picture.putpalette(palette.tobytes())
    buffer = io.BytesIO()
    picture.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def encode_error_map(errors: NDArray) -> bytes:
    """An error map on the colour scale; what is not covered is white. A palette keeps the page a third as large."""
    palette = (matplotlib.colormaps["magma"](np.linspace(0.0, 1.0, 255))[:, :3] * 255.0 + 0.5).astype(np.uint8)
    index = np.clip(np.nan_to_num(errors) / ERROR_SCALE, 0.0, 1.0) * 254.0 + 0.5
    image = np.where(np.isnan(errors), 255, index.astype(np.uint8)).astype(np.uint8)
    return encode_picture(image, np.concatenate([palette, [[255, 255, 255]]]).astype(np.uint8))
