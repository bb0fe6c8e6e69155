"""Reading of YAML files that somebody else may have written."""

import os
from collections.abc import Hashable
from typing import Any

import yaml

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import read_bytes

# Calibrations and settings have a few kilobytes.
_LARGEST_BYTES = 2**20


def read_yaml(path: str | os.PathLike[str], name: str) -> Any:
    """Content of a YAML file.

    Parameters
    ----------
    path : str or path-like
    name : str
        What to call it in messages.

    Raises
    ------
    InputError
        If it is no regular file, or larger than 1 MiB; if it is not valid YAML; if it has a key
        twice, of which one would be lost; or if it has aliases, which may make it huge.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "a.yaml")
    ...     _ = file.write_text("image_width: 640")
    ...     read_yaml(file, "a.yaml")
    {'image_width': 640}
    """
    data = read_bytes(path, name, _LARGEST_BYTES)
    try:
        return yaml.load(data.decode("utf-8"), _Loader)
    except _RefusedError as error:
        raise InputError(f"{name}: {error}") from error
    # Also dates, escapes, numbers, and brackets within brackets.
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise InputError(f"{name}: not valid YAML{line}") from error


class _RefusedError(Exception):
    """What is valid YAML, but must not be read."""


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses keys given twice, and aliases."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse an alias before it is followed."""
        if self.check_event(yaml.AliasEvent):
            line = self.peek_event().start_mark.line + 1
            raise _RefusedError(f"line {line} has an alias (*): write the value itself")
        node: yaml.Node | None = super().compose_node(parent, index)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Refuse a key that was there before."""
        lines: dict[Hashable, int] = {}
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            line = key_node.start_mark.line + 1
            if isinstance(key, Hashable) and lines.setdefault(key, line) != line:
                raise _RefusedError(
                    f"{key} is in line {lines[key]} and in line {line}: delete one of them"
                )
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return mapping
