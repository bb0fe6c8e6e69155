#!/usr/bin/env python3
"""Count the files and the lines of code along the reading path of docs/architecture.md.

A line of code has a token that is neither a comment nor part of a docstring. The path is the
numbered list under the heading "Reading path"; each item begins with a link to a file.
"""

import ast
import io
import re
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST_FILES, MOST_LINES = 8, 1000
_SILENT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip


def lines_of_code(source: str) -> int:
    """Count the lines of a Python text that hold code: no blank lines, comments, docstrings."""
    held: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _SILENT:
            held.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        # Docstrings, and texts below an attribute.
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            held.difference_update(range(node.lineno, node.end_lineno + 1))
    return len(held)


def reading_path(text: str) -> list[str]:
    """Return the files that the document's numbered list links to, from the project's root."""
    section = text.split("## Reading path")[1].split("\n## ")[0]
    return re.findall(r"^\d+\. \[[^\]]*\]\(\.\./([^)#]+)\)", section, re.MULTILINE)


def main() -> int:
    """Print the count; the exit status is 1 if the path is too long."""
    files = reading_path((ROOT / "docs/architecture.md").read_text(encoding="utf-8"))
    counts = {name: lines_of_code((ROOT / name).read_text(encoding="utf-8")) for name in files}
    for name, count in counts.items():
        print(f"{count:6d}  {name}")
    total = sum(counts.values())
    print(f"{total:6d}  lines of code in {len(files)} files (at most {MOST_LINES} in {MOST_FILES})")
    return int(not 0 < len(files) <= MOST_FILES or total > MOST_LINES)


if __name__ == "__main__":
    sys.exit(main())
