"""Settings of Sphinx; `scripts/docs` builds the site."""

import re
from importlib.metadata import version as installed_version

from sphinx.domains.python import PyObject

project = "slepian_prt"
author = "the authors of slepian_prt"
release = version = installed_version("slepian_prt")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["build"]
default_role = "literal"
highlight_language = "python"

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3

# Types stand in the docstrings, with shapes; they are words, not links.
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
autodoc_default_options = {"exclude-members": "__init__, __new__"}
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True
nitpick_ignore_regex = [("py:(class|obj|exc)", ".*")]

html_theme = "furo"
html_title = f"slepian_prt {release}"
html_show_copyright = False
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["tables.css"]


def _one_attribute_a_line(_app, _what, _name, _object, _options, lines):
    """ "a, b : int" of a section Attributes as two, because the extension napoleon knows one name a line."""
    for number in reversed(range(len(lines))):
        several = re.fullmatch(r"(\w+(?:, \w+)+) : (.+)", lines[number])
        if several:
            lines[number : number + 1] = [f"{name} : {several[2]}" for name in several[1].split(", ")]


def _escape_bars(_app, _what, _name, _object, _options, lines):
    """Absolute values such as |U| are not substitutions of reStructuredText; what is in backticks stays."""
    for number, line in enumerate(lines):
        parts = line.split("`")
        lines[number] = "`".join(part if i % 2 else part.replace("|", r"\|") for i, part in enumerate(parts))


def setup(app):
    app.connect("autodoc-process-docstring", _one_attribute_a_line, priority=400)  # before napoleon
    app.connect("autodoc-process-docstring", _escape_bars)
    for kind in PyObject.doc_field_types:
        if kind.name == "variable":
            kind.label = "Attributes"
