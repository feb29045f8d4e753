"""What codings start from, as JSON: a sweep that goes on codes what is left as it would have without a stop."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from slepian_prt.compression.codec.caps import Tuning
from slepian_prt.compression.codec.contexts import Contexts
from slepian_prt.compression.codec.prediction import Predictor
from slepian_prt.compression.encoder import WarmStart

Tables = TypeVar("Tables", Predictor, Contexts)


def start_as_json(start: WarmStart | None) -> dict[str, Any] | None:
    """Plain values."""
    if start is None:
        return None
    tuning = start.tuning
    return {
        "step": float(tuning.step),
        "predictor": _lists(tuning.predictor),
        "contexts": _lists(tuning.contexts),
        "principal_axes": [bool(turned) for turned in start.principal_axes],
    }


def start_from_json(content: dict[str, Any] | None) -> WarmStart | None:
    """What `start_as_json` was called of.

    Raises
    ------
    KeyError, TypeError, ValueError
        It is nothing of the kind.
    """
    if content is None:
        return None
    predictor, contexts = _tables(Predictor, content["predictor"]), _tables(Contexts, content["contexts"])
    axes = tuple(bool(turned) for turned in content["principal_axes"])
    return WarmStart(Tuning(float(content["step"]), predictor, contexts), axes)


def _lists(tables: Predictor | Contexts) -> dict[str, Any]:
    return {field.name: getattr(tables, field.name).tolist() for field in fields(tables)}


def _tables(kind: type[Tables], content: dict[str, Any]) -> Tables:
    return kind(**{field.name: np.array(content[field.name], dtype=np.uint8) for field in fields(kind)})
