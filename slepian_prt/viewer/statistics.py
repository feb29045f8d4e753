"""What a page tells in words: what the file holds, what was simulated, what is lost, and what is not drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files.file_size import file_size
from slepian_prt.relighting.source import missing_in_picture
from slepian_prt.runtime.gpu_transfer import GpuTransfer
from slepian_prt.transport.effects import Effect
from slepian_prt.viewer.models import Model

# A title, and pairs of a label and what is said of it.
Section = list[str | list[list[str]]]

# How rows of the effects plan begin that are about textures.
_TEXTURE = "texture between vertices"


def statistics(models: Sequence[Model], words: Callable[[str], str]) -> list[Section]:
    """Sections of text about the models of a page, the first at length; ``words`` puts names of parameters in words."""
    packed, transfer = models[0].packed, models[0].transfer
    sections = [
        _section("Model", _model(packed)),
        _section("Bytes", _bytes(packed, transfer)),
        _section("Error", _errors(packed, transfer)),
        _section("Light transport", [[words(effect.name), words(_effect(effect))] for effect in packed.effects]),
    ]
    for other in models[1:]:
        rows = [*_model(other.packed), *_errors(other.packed, other.transfer)]
        sections.append(_section(f"Compared with {other.label}", rows))
    return [section for section in sections if section[1]]


def remarks(packed: CompressedTransfer, *, textured: bool) -> list[str]:
    """What the page does not draw as the scene has it."""
    said = [f"Repaired in the mesh: {note}." for note in packed.notes]
    lacking = [name for name in missing_in_picture(packed) if not (textured and name.startswith(_TEXTURE))]
    if lacking and packed.film is None:
        said.append(f"Left out, as the file does not hold it: {'; '.join(lacking)}. Pictures of the scene have it.")
    if textured:
        said.append("Textures are those of the model's own file.")
    return said


def lacks_textures(packed: CompressedTransfer) -> bool:
    """Whether textures have detail that vertices do not hold."""
    return any(name.startswith(_TEXTURE) for name in missing_in_picture(packed))


def _section(title: str, rows: list[list[str]]) -> Section:
    return [title, rows]


def _model(packed: CompressedTransfer) -> list[list[str]]:
    film = packed.film_outline
    rows = [["source", Path(packed.source).name or packed.name]]
    if film is None:
        rows += [["vertices", f"{packed.vertex_count:,}"], ["faces", f"{packed.face_count:,}"]]
    else:
        rows += [["pixels", f"{film.width} x {film.height}"], ["camera", film.name]]
    rows += [
        ["bandlimit", f"L = {packed.bandlimit}: {(packed.bandlimit + 1) ** 2} harmonics"],
        ["basis", f"{packed.basis}, {packed.terms:.3g} functions per vertex"],
        ["caps", f"{packed.cap_count}"],
        ["colours of transfer", "one for all" if packed.channels == 1 else "red, green and blue"],
    ]
    if packed.prior:
        rows.append(["made for light like", packed.prior])
    if packed.lamp_names:
        rows.append(["lamps", ", ".join(packed.lamp_names)])
    if packed.toward_view and packed.view is not None:
        rows.append(["toward camera", packed.view.name])
    return rows


def _bytes(packed: CompressedTransfer, transfer: GpuTransfer) -> list[list[str]]:
    vertices, whole = packed.vertex_count, file_size(packed).whole
    uploaded = transfer.vertices.nbytes
    table = transfer.cap_count * transfer.function_count * 3 * 4
    each = "vertex" if packed.film_outline is None else "pixel"
    return [
        ["file", f"{whole:,} bytes, {whole / vertices:.3g} per {each}"],
        ["on the graphics card", f"{uploaded:,} bytes, {transfer.function_count} per {each}"],
        ["made anew for each light", f"{table:,} bytes"],
        ["full harmonics, float32", f"{4 * vertices * packed.channels * (packed.bandlimit + 1) ** 2:,} bytes"],
    ]


def _errors(packed: CompressedTransfer, transfer: GpuTransfer) -> list[list[str]]:
    rows = [["file, predicted", f"{packed.predicted_relit_error():.2%} of relit radiance"]]
    rows += [[f"file, verified under {light}", f"{error:.2%}"] for light, error in packed.verified.items()]
    rows += [
        ["bytes for the graphics card", f"{transfer.error():.2%}"],
        ["together", f"{transfer.relit_error():.2%}"],
    ]
    if packed.path_noise is not None:
        rows.append(["noise of paths", f"{packed.path_noise:.2%}"])
    noise = packed.noise()
    if noise is not None:
        rows.append(["noise of the picture", f"{noise:.2%}"])
    return rows


def _effect(effect: Effect) -> str:
    """A row of the plan as a sentence."""
    amount = "" if effect.contribution is None else f", {effect.contribution:.3f}"
    if amount and effect.confidence:
        amount += f" ± {effect.confidence:.3f}"
    return f"{effect.verdict}{amount}: {effect.reason}"
