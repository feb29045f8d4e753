"""Lighting as text: a line of red, green and blue for each harmonic, in the order l² + l + m.

GAMES202's program writes nine of them to ``light.txt``, of the harmonics of ours. It takes posy.jpg for what is below
and posz.jpg for what is behind, as its list of files and that of their directions disagree: make such a file of a map
with `project_environment` where that matters.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.lighting.fitting import LARGEST
from slepian_prt.machine.file_content import read_content

SUFFIX = ".txt"


def is_light_text(path: str | Path) -> bool:
    """Whether that is the path of such a file."""
    return Path(path).suffix.lower() == SUFFIX


def read_light_text(path: str | Path) -> NDArray[np.float64]:
    """(3, n²) coefficients.

    Raises
    ------
    UserError
        Missing or unreadable; a line that is not three numbers, or too large ones; a number of lines that is no square.
    """
    path = Path(path)
    check_readable(path, "lighting as text")
    try:
        lines = read_content(path).decode("utf-8-sig").splitlines()  # Windows puts a byte order mark before it
    except UnicodeDecodeError:
        raise UserError(f"{path}: cannot be read as lighting: it is no text") from None
    rows = [_numbers(path, number, line) for number, line in enumerate(lines, 1) if line.strip()]
    if not rows or math.isqrt(len(rows)) ** 2 != len(rows):
        raise UserError(f"{path}: has {len(rows)} lines of lighting, and harmonics up to a degree are 1, 4, 9, 16, …")
    return np.array(rows).T.copy()


def _numbers(path: Path, number: int, line: str) -> list[float]:
    try:
        if "_" in line or not line.isascii():  # Python takes 1_0 for 10, and digits of other scripts
            raise ValueError
        values = [float(word) for word in line.split()]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise UserError(f"{path}: line {number}: must be red, green and blue of a harmonic, three numbers")
    if max(map(abs, values)) > LARGEST:
        raise UserError(f"{path}: line {number}: is light beyond {LARGEST:g}, more than pictures hold; scale it down")
    return values


def light_text(lighting: NDArray) -> bytes:
    """Lighting (3, n²) as such a file, with all digits that float64 has."""
    return "".join(f"{red:.16e} {green:.16e} {blue:.16e}\n" for red, green, blue in lighting.T).encode()


def is_written_here(path: Path) -> bool:
    """Whether a file is what `light_text` makes of its numbers, which nobody writes by hand or with six digits."""
    try:
        return path.read_bytes() == light_text(read_light_text(path))
    except (UserError, OSError):
        return False
