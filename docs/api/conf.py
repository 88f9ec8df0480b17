"""Sphinx configuration of the API reference (`make docs`)."""

from gscore import __version__

project = "gscore"
release = version = __version__
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "alabaster"
html_theme_options = {"description": "3D Gaussian Splatting on CPUs and graphics cards"}
html_show_copyright = False
default_role = "literal"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_use_ivar = True


def keep_colons(app, what, name, obj, options, lines):
    """Napoleon takes words before a colon in an attribute's docstring for its type."""
    if what == "attribute":
        lines[:] = [line.replace(": ", " \N{EN DASH} ", 1) for line in lines]


def setup(app):
    """Connect before napoleon, which has priority 500."""
    app.connect("autodoc-process-docstring", keep_colons, priority=400)
