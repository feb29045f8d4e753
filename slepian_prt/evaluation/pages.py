"""Templates of the pages of reports."""

from __future__ import annotations

import base64
import re

import jinja2
from markupsafe import Markup, escape

from slepian_prt.evaluation import plots


def load_template(name: str) -> jinja2.Template:
    """A template of this package.

    Its filters: ``uri`` for pictures, ``percent`` for errors, ``seconds`` for times, ``code`` for sentences that name
    parameters between backticks.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slepian_prt", "evaluation"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["uri"] = lambda png: "data:image/png;base64," + base64.b64encode(png).decode()
    environment.filters["percent"] = plots.percent
    environment.filters["seconds"] = plots.seconds
    environment.filters["code"] = lambda text: Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))
    return environment.get_template(name)
