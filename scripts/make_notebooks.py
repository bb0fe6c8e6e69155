"""Write the examples as notebooks, which Jupyter and Colab open.

python scripts/make_notebooks.py

A block of comments after a line `# %%` becomes text, what follows it code. The first cell installs
the package from the public address of its sources, which `package.xml` has.
"""

import ast
import json
import re
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
NOTEBOOKS = EXAMPLES / "notebooks"
_INSTALL = (
    "# Only where the package is not installed yet, as in Colab.\n"
    '%pip install -q "coded_aperture_ros[eval] @ git+{}"'
)
_METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def repository() -> str:
    """Return the public address of the sources."""
    urls = ElementTree.parse(ROOT / "package.xml").findall("url")
    return next(url.text or "" for url in urls if url.get("type") == "repository")


def first_cell() -> str:
    """Return the code that installs the package."""
    return _INSTALL.format(repository())


def notebook(source: str) -> str:
    """Return the notebook of an example, as JSON."""
    title = ast.get_docstring(ast.parse(source)) or ""
    head, rule, text = title.split("\n", 2)
    assert set(rule) == {"="}
    cells = [_markdown(f"# {head}\n{text}"), _code(first_cell())]
    for block in source.split("\n# %%\n")[1:]:
        comment, code = re.fullmatch(r"((?:#[^\n]*\n)*)(.*)", block, re.DOTALL).groups()
        cells.append(_markdown(re.sub("^# ?", "", comment, flags=re.MULTILINE)))
        if code.strip():
            cells.append(_code(code))
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    content = {"cells": cells, "metadata": _METADATA, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def notebooks() -> dict[Path, str]:
    """Return all notebooks, by path."""
    paths = sorted(EXAMPLES.glob("plot_*.py"))
    return {NOTEBOOKS / f"{path.stem}.ipynb": notebook(path.read_text()) for path in paths}


def _markdown(text: str) -> dict:
    lines = text.replace("``", "`").strip().splitlines(keepends=True)
    return {"cell_type": "markdown", "metadata": {}, "source": lines}


def _code(text: str) -> dict:
    lines = text.strip().splitlines(keepends=True)
    empty = {"execution_count": None, "outputs": []}
    return {"cell_type": "code", "metadata": {}, "source": lines, **empty}


if __name__ == "__main__":
    NOTEBOOKS.mkdir(exist_ok=True)
    for path, text in notebooks().items():
        path.write_text(text)
