"""The documentation site: `sphinx-build -W -b html docs build/docs`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sphinx.util.inspect import TypeAliasForwardRef

import navgym
from navgym.problem import REGISTERED

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "navgym"
author = "The navgym maintainers"
copyright = author  # noqa: A001 - Sphinx's name for it
version = release = navgym.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["images"]

# pages are read on forges too: links are relative paths of files, anchors are those of GitHub
myst_heading_anchors = 3
highlight_language = "none"

# docstrings say `name`, of whatever can be linked and of what cannot
default_role = "py:obj"
add_module_names = False
python_maximum_signature_line_length = 80
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {
    name: name for name in ("Array", "ArrayLike", "NDArray", "Parameters", "Span", "Where")
}
TypeAliasForwardRef.__repr__ = lambda self: self.name  # else signatures say how Sphinx keeps it
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

# pages of environments by the name of their class
MANUALS = {
    where.single.replace(":", "."): where.environment.partition("/")[2]
    for where in REGISTERED.values()
}

html_theme = "furo"
html_title = f"navgym {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False


def _docstring(
    _app: Sphinx, _what: str, name: str, _thing: Any, _options: Any, lines: list[str]
) -> None:
    """Make a docstring what Sphinx can read.

    An environment's is its manual, in Markdown, and has a page of its own; |x| is a magnitude.
    """
    environment = MANUALS.get(name)
    if environment:
        lines[:] = [lines[0], "", f"Manual: :doc:`../environments/{environment}`."]
    lines[:] = [
        line if "``" in line or ">>>" in line else line.replace("|", r"\|") for line in lines
    ]


def _signature(
    _app: Sphinx, what: str, _name: str, _thing: Any, _options: Any, given: Any, returned: Any
) -> tuple[str, str] | None:
    """Make a signature what Sphinx can parse; a protocol's says nothing."""
    if what == "class" and given == "(*args, **kwargs)":
        return "", ""
    return (given.replace("<factory>", "..."), returned) if given else None


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _docstring)
