"""Parameters of Mitsuba scenes: values that an .xml file leaves open, as ``$name``."""

from __future__ import annotations

import numbers
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slepian_prt.errors import UserError


def scene_parameters(parameters: Mapping[str, object] | None) -> dict[str, str]:
    """Values of a scene's ``$name`` as they are written in XML.

    Raises
    ------
    UserError
        No dict of names, or a value that is no number, bool or str.
    """
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise UserError(f"parameters must be a dict of names and values, not {parameters!r}")
    written = {}
    for name, value in parameters.items():
        if not isinstance(name, str) or not re.fullmatch(r"\w+", name):
            raise UserError(f"parameters must have names of letters, digits and underscores, not {name!r}")
        if isinstance(value, bool | np.bool_):
            written[name] = "true" if value else "false"
        elif isinstance(value, str | Path | numbers.Real):
            written[name] = str(value)
        else:
            raise UserError(f"parameters must be numbers, booleans or strings; {name!r} is {value!r}")
    return written
