"""The conventions are said where a user looks."""

from pathlib import Path

import pytest

import slepian_prt as sp

DOCS = Path(__file__).parent.parent / "docs"

ORDER, PHASE, NORM, AXIS = "l² + l + m", "Condon–Shortley phase", "orthonormal", "polar axis"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("real_sh", (ORDER, PHASE, NORM, AXIS, "up in scenes and maps is y", "convert_sh")),
        ("Transfer", (ORDER, PHASE, NORM, AXIS, "(1/π) ∫ V(ω) (n·ω)₊ y_lm(ω) dω", "convert_sh")),
        (
            "project_environment",
            (ORDER, PHASE, NORM, "y up", "on the poles", "r/(H-1)", "rows at centres", "convert_sh"),
        ),
        ("convert_sh", (ORDER, PHASE, NORM, "polar axis z", "1/π", "quantity")),
        ("mask_region", ("SHTOOLS", "half a cell", "samples at points")),
    ],
)
def test_help_says_them(name, words):
    text = " ".join((getattr(sp, name).__doc__ or "").split())
    for word in words:
        assert word in text, f"help(sp.{name}) does not say {word!r}"


@pytest.mark.parametrize(
    "word", [ORDER, "Condon–Shortley phase", NORM, "the polar axis", "y is up", "(1/π)", "on the poles"]
)
def test_the_page_says_them(word):
    assert word in (DOCS / "conventions.md").read_text()
