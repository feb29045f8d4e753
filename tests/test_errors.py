"""What is no transfer is told in one line, wherever one is wanted."""

import re
from pathlib import Path

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import check_choice, check_real

LIGHT = np.zeros((3, 4))
WANT_TRANSFER = {
    "relight": lambda transfer: sp.relight(transfer, LIGHT),
    "compress": sp.compress,
    "compress_film": sp.compress_film,
    "render_picture": lambda transfer: sp.render_picture(transfer, LIGHT),
    "save_picture": lambda transfer: sp.save_picture("picture.png", transfer, LIGHT),
    "save_page": lambda transfer: sp.save_page("page.html", transfer, "sky.exr"),
    "gpu_transfer": sp.gpu_transfer,
    "export_model": lambda transfer: sp.export_model(transfer, "model.glb"),
    "effective_dimension": sp.effective_dimension,
}


@pytest.mark.parametrize("name", WANT_TRANSFER)
@pytest.mark.parametrize("given", ["scan.prt", Path("scan.prt"), 3, None, np.zeros((4, 1, 9))], ids=type)
def test_what_is_no_transfer(name, given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(sp.UserError, match=r"transfer|CompressedTransfer") as told:
        WANT_TRANSFER[name](given)
    assert "\n" not in str(told.value)
    assert not list(tmp_path.iterdir())


def test_a_path_is_told_what_to_do():
    with pytest.raises(sp.UserError, match=re.escape("give sp.load('scan.prt')")):
        sp.relight("scan.prt", LIGHT)


@pytest.mark.parametrize(("given", "told"), [("Hann", "; did you mean hann?"), ("box", "not 'box'"), (3, "not 3")])
def test_names_that_are_nearly_right(given, told):
    with pytest.raises(sp.UserError, match=f"{re.escape(told)}$"):
        check_choice(given, "window", ("hann", "lanczos"))


def test_values_are_told_in_one_short_line():
    with pytest.raises(sp.UserError, match=r"^part must be a number in \[0, 1\], not .{1,80}$"):
        check_real(np.linspace(0.0, 1.0, 99), "part", "[0, 1]", lambda x: 0.0 <= x <= 1.0)
