"""``slepian-prt view``."""

from __future__ import annotations

import os
import sys
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.commands import with_flags
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    clamp_option,
    environment_option,
    file_argument,
    fixed_lights_option,
    output_option,
    picture_options,
    rotate_option,
)
from slepian_prt.cli.values import read_transfer, settings_of

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.transport.transfer import Transfer


@click.command()
@file_argument
@environment_option("Map that the page carries")
@rotate_option
@clamp_option
@click.option(
    "--compare-with",
    type=click.Path(),
    metavar="FILE",
    help="Another transfer of the model, behind a slider: a .prt of another basis, or an .npz of full SH.",
)
@click.option(
    "--functions",
    type=click.Choice(["8", "16", "24", "32"]),
    default="16",
    show_default=True,
    help="Bytes of a vertex: more lose less.",
)
@fixed_lights_option
@picture_options
@click.option("--scene", type=click.Path(), metavar="PATH", help="What FILE was made from: its textures are drawn.")
@click.option("--no-open", is_flag=True, help="Do not open the page in a browser.")
@output_option("Where to write the page, an .html file.")
@machine_options
def view(
    file: str,
    environment: tuple[str, ...],
    compare_with: str | None,
    functions: str,
    scene: str | None,
    no_open: bool,
    output: str,
    **options: Any,
) -> None:
    """Make a page of a transfer FILE: one .html that any browser opens from a disk, to turn model and light in.

    FILE may be full SH, too (.npz). The page carries the model, the maps and the program that draws them; maps that
    are dropped on it shine too. Behind the model is the map unless --background says otherwise. On a terminal it is
    opened.
    """
    from slepian_prt.relighting.files.wishes import check_source
    from slepian_prt.scene.named_files import check_output_file
    from slepian_prt.scene.view import Aim
    from slepian_prt.viewer.page_file import check_page_name, write_page
    from slepian_prt.viewer.pages import PageWish, page_content
    from slepian_prt.viewer.payload import make_payload

    aim = settings_of(Aim, options)
    wish = settings_of(PageWish, options, maps=environment, functions=int(functions), aim=aim, scene=scene)
    check_page_name(output)
    given = [path for path in (compare_with, scene) if path]
    check_output_file(output, file, *environment, *given)
    transfer = _read(file)
    check_source(output, transfer, file)
    content = page_content(transfer, wish, None if compare_with is None else _read(compare_with), file, note)
    size = write_page(output, content.title, make_payload(replace(content, words=with_flags)))
    step = content.models[0].transfer.error()
    lights = ", ".join(light.name for light in content.lights)
    say(
        f"{output}: {size / 1e6:.3g} MB with {lights}, {functions} bytes per vertex, which lose {step:.2g} beside the "
        "file's own error"
    )
    if not no_open:
        _open(output)


def _read(file: str) -> Transfer | CompressedTransfer:
    """A .prt file, or full SH as `Transfer.save` writes it."""
    if Path(file).suffix.lower() == ".npz":
        from slepian_prt.transport.transfer_file import load_transfer

        return load_transfer(file)
    return read_transfer(file)


def _open(output: str) -> None:
    """In the user's browser, where there is a terminal to ask from and a screen to show it on."""
    has_screen = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.stdout.isatty() and not (has_screen and webbrowser.open(Path(output).resolve().as_uri())):
        note(f"{output}: no browser is at hand here; open it in one")
