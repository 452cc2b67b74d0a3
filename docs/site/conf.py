"""Sphinx's settings; ``scripts/docs`` runs it on the pages that prepare.py wrote."""

from calstudy import __version__

project = "calstudy"
author = copyright = "the calstudy developers"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",  # scikit-learn's sections of docstrings
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
exclude_patterns = ["files/**"]

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4

default_role = "py:obj"  # `name` in a docstring: a link where there is something to link to
suppress_warnings = ["ref.python"]  # `n` in a docstring may be an argument here and an attribute elsewhere
autodoc_default_options = {
    "members": True,
    "undoc-members": True,
    "show-inheritance": True,
    "exclude-members": "set_fit_request, set_predict_request, set_score_request",  # scikit-learn's own
}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
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
