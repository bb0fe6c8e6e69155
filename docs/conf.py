"""Configuration of the documentation, for `make docs` and for rosdoc2."""

import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
# rosdoc2 builds from a copy that may lack what the nodes need; the library does not need it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

project = "coded_aperture_ros"
author = "The coded_aperture_ros authors"
copyright = author
version = release = re.search(
    r'^__version__ = "(.+)"$', (ROOT / project / "__init__.py").read_text(), re.MULTILINE
)[1]

extensions = ["myst_parser", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "generated"]
html_theme = "alabaster"
html_theme_options = {
    "description": "Metric depth from a coded-aperture camera",
    "page_width": "70em",
}

myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Documents that lie outside docs/, where readers of the sources look for them.
OUTSIDE = {
    "readme": "README.md",
    "contributing": "CONTRIBUTING.md",
    "benchmarks": "benchmarks/README.md",
}


def read_from_outside(app, docname, source):
    """Bring in a document from outside docs/, and let links between documents meet."""
    path = ROOT / OUTSIDE.get(docname, f"docs/{docname}.md")
    if not path.is_file():
        return
    pages = {ROOT / outside: f"{name}.md" for name, outside in OUTSIDE.items()}

    def link(match):
        target, mark, anchor = match[1].partition("#")
        if ":" in target or not target:
            return match[0]
        there = (path.parent / target).resolve()
        found = pages.get(there) or os.path.relpath(there, ROOT / "docs")
        return f"]({found}{mark}{anchor})"

    source[0] = re.sub(r"\]\(([^)\s]+)\)", link, path.read_text())


def setup(app):
    """Register the above with Sphinx."""
    app.connect("source-read", read_from_outside)
