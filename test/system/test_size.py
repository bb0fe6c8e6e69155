"""Functions and files stay short enough to be read at one go."""

import ast

import pytest

PARTS = ("coded_aperture_ros", "viewer", "training")
LONGEST_FUNCTION = 60
LONGEST_FILE = 400


def lengths(source):
    """Return how many lines a text has, and each of its functions without its docstring."""
    functions = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            count = node.end_lineno - node.lineno + 1
            if ast.get_docstring(node) is not None:
                count -= node.body[0].end_lineno - node.body[0].lineno + 1
            functions.append((node.name, count))
    return len(source.splitlines()), functions


@pytest.mark.parametrize("part", PARTS)
def test_no_function_and_no_file_is_too_long(checkout, part):
    too_long = []
    paths = sorted((checkout / part).rglob("*.py"))
    assert paths
    for path in paths:
        whole, functions = lengths(path.read_text(encoding="utf-8"))
        name = path.relative_to(checkout).as_posix()
        if whole > LONGEST_FILE:
            too_long.append(f"{name}: {whole} lines")
        too_long += [
            f"{name}: {function}: {count} lines"
            for function, count in functions
            if count > LONGEST_FUNCTION
        ]
    assert too_long == []


def test_lengths_are_counted():
    source = "def short():\n    pass\n\n\nclass Some:\n    def long(self):\n"
    source += '        """Say\n\n        more."""\n        a = 1\n        return a\n'
    assert lengths(source) == (11, [("short", 2), ("long", 3)])
