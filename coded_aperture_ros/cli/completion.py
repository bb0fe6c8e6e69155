"""Completion by the tab key: `eval "$(register-python-argcomplete coded_aperture)"`."""

import argparse
import os
from collections.abc import Mapping, Sequence
from typing import Any

from coded_aperture_ros.cli.parser import make_parser
from coded_aperture_ros.cli.table import Actions, Entry


def complete(program: str, commands: Mapping[str, Any]) -> None:
    """Answer the shell, and end the process; do nothing if it is not a shell that asks."""
    import argcomplete

    parser = argparse.ArgumentParser(prog=program, add_help=False)
    _add(parser, commands, os.environ.get("COMP_LINE", "").split())
    argcomplete.autocomplete(parser)


def _add(
    parser: argparse.ArgumentParser, commands: Mapping[str, Any], words: Sequence[str]
) -> None:
    """Let a parser choose among commands; those that `words` name have their options."""
    subparsers = parser.add_subparsers()
    for name, entry in commands.items():
        if name in words and isinstance(entry, Entry):
            options = make_parser(entry.load(), name, everything=True)
            subparsers.add_parser(name, parents=[options], add_help=False)
            continue
        below = subparsers.add_parser(name, add_help=False)
        if name in words and isinstance(entry, Actions):
            _add(below, entry.actions, words)
