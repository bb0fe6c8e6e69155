"""Configuration of the documentation, for `make docs` and for rosdoc2."""

import os
import re
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]
# rosdoc2 builds from a copy that may lack what the nodes need; the library does not need it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

project = "coded_aperture_ros"
author = "The coded_aperture_ros authors"
copyright = author
version = release = re.search(
    r'^__version__ = "(.+)"$', (ROOT / project / "__init__.py").read_text(), re.MULTILINE
)[1]

# rosdoc2 brings its own set of packages, without furo and numpydoc.
docstrings = "numpydoc" if find_spec("numpydoc") else "sphinx.ext.napoleon"
extensions = ["myst_parser", docstrings, "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
if find_spec("sphinx_gallery"):  # nor this one: then the page of the examples has none
    extensions.append("sphinx_gallery.gen_gallery")
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "generated/gallery",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "first_notebook_cell": import_module("make_notebooks").first_cell(),
    "download_all_examples": False,
    "write_computation_times": False,
    "show_signature": False,
    "capture_repr": (),  # what is printed, but not the value of a last line
}
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
html_theme = "furo" if find_spec("furo") else "alabaster"
html_title = f"{project} {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]

myst_heading_anchors = 4
smartquotes = False  # options begin with two hyphens
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Documents outside docs/, where readers of the sources look for them; the site has copies.
OUTSIDE = {
    ROOT / "README.md": "readme",
    ROOT / "CONTRIBUTING.md": "contributing",
    ROOT / "CHANGELOG.rst": "changelog",
    ROOT / "benchmarks" / "README.md": "benchmarks",
    ROOT / "examples" / "GALLERY_HEADER.rst": "gallery/index",
}
COPIES = DOCS / "generated"


def text_for_site(path, folder):
    """Text of a Markdown file with its links rewritten for a page in `folder`."""

    def link(match):
        target, mark, anchor = match[1].partition("#")
        if ":" in target or not target:
            return match[0]
        there = (path.parent / target).resolve()
        if there in OUTSIDE:
            there = COPIES / f"{OUTSIDE[there]}{there.suffix}"
        return f"]({os.path.relpath(there, folder)}{mark}{anchor})"

    return re.sub(r"\]\(([^)\s]+)\)", link, path.read_text())


def copy_outside_documents():
    """Write the copies, where their text has changed."""
    (COPIES / "gallery").mkdir(parents=True, exist_ok=True)
    for path, name in OUTSIDE.items():
        copy = COPIES / f"{name}{path.suffix}"
        if not path.is_file():
            copy.unlink(missing_ok=True)
            continue
        text = text_for_site(path, COPIES) if path.suffix == ".md" else path.read_text()
        if not copy.is_file() or copy.read_text() != text:
            copy.write_text(text)


def lead_links_to_copies(app, docname, source):
    """Let links of a page to documents outside docs/ lead to their copies."""
    path = DOCS / f"{docname}.md"
    if path.is_file() and path.parent != COPIES:
        source[0] = text_for_site(path, path.parent)


copy_outside_documents()


def setup(app):
    """Register the above with Sphinx."""
    app.connect("source-read", lead_links_to_copies)
