"""Where figures go, and how all of them look."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).parent.parent
FIGURES = ROOT / "docs" / "figures"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")

plt.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})


def save(figure: plt.Figure, name: str) -> None:
    """Write a figure as docs/figures/NAME.png."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / f"{name}.png", dpi=150, bbox_inches="tight")
    plt.close(figure)
    print(f"docs/figures/{name}.png")


def write(name: str, picture: bytes) -> None:
    """Write a picture that is encoded already."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / f"{name}.png").write_bytes(picture)
    print(f"docs/figures/{name}.png")
