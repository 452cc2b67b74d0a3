"""Sphinx's settings; ``scripts/docs`` runs it on the pages that prepare.py wrote."""

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring

from calstudy import __version__

project = "calstudy"
author = copyright = "the calstudy developers"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
]
if "quick" not in tags:  # noqa: F821 (Sphinx defines it)
    extensions.append("sphinx.ext.viewcode")  # pages of the sources take as long as all others
exclude_patterns = ["files/**"]

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4

default_role = "py:obj"  # `name` in a docstring: a link where there is something to link to
suppress_warnings = ["ref.python"]  # `n` in a docstring may be an argument here and an attribute elsewhere
autodoc_default_options = {
    "members": True,
    "undoc-members": True,
    "exclude-members": "set_fit_request, set_predict_request, set_score_request",  # scikit-learn's own
}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_class_signature = "mixed"
python_maximum_signature_line_length = 80
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"calstudy {__version__}"
html_static_path = ["site/style.css"]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"


def setup(app: Sphinx) -> None:
    """Add what the docstrings need beyond Sphinx."""
    app.connect("autodoc-process-docstring", sections)


def sections(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Read sections in scikit-learn's style. In constants, napoleon would take `a: b` for a section."""
    if what in ("class", "function"):
        lines[:] = NumpyDocstring(lines, Config(), app, what, name, obj, options).lines()
