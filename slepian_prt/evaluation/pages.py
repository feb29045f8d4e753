"""Templates of the pages of reports."""

from __future__ import annotations

import base64

import jinja2

from slepian_prt.evaluation import plots


def load_template(name: str) -> jinja2.Template:
    """A template of this package, with filters for pictures (``uri``), errors (``percent``) and times (``seconds``)."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slepian_prt", "evaluation"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["uri"] = lambda png: "data:image/png;base64," + base64.b64encode(png).decode()
    environment.filters["percent"] = plots.percent
    environment.filters["seconds"] = plots.seconds
    return environment.get_template(name)
