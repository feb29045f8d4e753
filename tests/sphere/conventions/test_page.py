"""The page *Coming from other tools* shows the table that `convert_sh` works by."""

from pathlib import Path

from slepian_prt.sphere.conventions.convert import convert_sh
from slepian_prt.sphere.conventions.neighbours import NEIGHBOURS

PAGE = Path(__file__).parents[3] / "docs" / "coming-from.md"


def rows() -> list[str]:
    """A line for each tool and each way that it holds numbers."""
    lines = []
    for name, neighbour in NEIGHBOURS.items():
        for form in dict.fromkeys(neighbour.forms.values()):
            what = ", ".join(q for q, other in neighbour.forms.items() if other == form)
            factor = form.factor.text + (f", {form.offset:g} less in the function" if form.offset else "")
            order = "" if neighbour.sequence is None else "; 1, x, y, z, xy, xz, yz, x² − y², 3z² − 1"
            array = f"{form.layout.shape}{order}"
            lines.append(f"| `{name}` | {neighbour.tool} | {neighbour.bandlimits} | {what} | {factor} | {array} |")
    return lines


def test_the_page_has_the_table():
    text = PAGE.read_text()
    shown = [line for line in text.splitlines() if line.startswith("| `") and line.count("|") == 7]
    assert shown == rows()


def test_the_help_has_the_names():
    for name in NEIGHBOURS:
        assert name in " ".join((convert_sh.__doc__ or "").split())
