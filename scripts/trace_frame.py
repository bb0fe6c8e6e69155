#!/usr/bin/env python3
"""Say which files of the package one command executes, and how many lines of code they have.

    python scripts/trace_frame.py [--json] COMMAND [ARGUMENT...]

    python scripts/trace_frame.py depth --bank bank.npz coded.png -o depth.npy

A file counts, with all its lines, if a function of it is called; what runs only because a module is
imported does not. Lines are counted without blank lines, comments and docstrings. Files are in the
order in which they are first called.
"""

import ast
import io
import json
import os
import runpy
import sys
import threading
import tokenize
from pathlib import Path
from types import FrameType

PACKAGE = Path(__file__).resolve().parent.parent / "coded_aperture_ros"
_NO_CODE = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)
_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(source: str) -> int:
    """Number of lines of a source text that are code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, _WITH_DOCSTRING) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            lines -= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(lines)


class Trace:
    """Takes down the files whose functions are called, in the order of their first call."""

    def __init__(self) -> None:
        self.files: dict[str, None] = {}

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """Take down one call; see `sys.setprofile`."""
        name = frame.f_code.co_filename
        is_new = name.startswith(f"{PACKAGE}{os.sep}") and name not in self.files
        if event == "call" and is_new and not _is_importing(frame):
            self.files[name] = None


def _is_importing(frame: FrameType | None) -> bool:
    """Whether a module of the package, but for the program itself, is being imported."""
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        is_module = frame.f_code.co_name == "<module>" and path.is_relative_to(PACKAGE)
        if is_module and path != PACKAGE / "__main__.py":
            return True
        frame = frame.f_back
    return False


def trace(arguments: list[str]) -> tuple[int, dict[str, int]]:
    """Status of a command, and the lines of code of every file that it executed."""
    sys.argv = ["coded_aperture", *arguments]
    found = Trace()
    status = 0
    threading.setprofile(found)
    sys.setprofile(found)
    try:
        runpy.run_module("coded_aperture_ros", run_name="__main__")
    except SystemExit as ended:
        status = int(ended.code or 0)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    lines = {
        Path(name).relative_to(PACKAGE).as_posix(): code_lines(Path(name).read_text("utf-8"))
        for name in found.files
    }
    return status, lines


def main() -> int:
    """Trace the command of the command line."""
    arguments = sys.argv[1:]
    as_json = arguments[:1] == ["--json"]
    status, lines = trace(arguments[as_json:])
    if as_json:
        print(json.dumps(lines))
        return status
    for name, count in lines.items():
        print(f"{count:6d}  {name}")
    for part, chosen in (("library", False), ("cli", True)):
        counts = [count for name, count in lines.items() if name.startswith("cli/") == chosen]
        print(f"{part}: {len(counts)} files, {sum(counts)} lines of code")
    return status


if __name__ == "__main__":
    sys.exit(main())
