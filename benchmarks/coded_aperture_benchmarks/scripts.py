"""What the programs beside this package share: data folder, errors, and tables to print."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.errors import InputError


def data_parser(description: str, holds: str) -> argparse.ArgumentParser:
    """Return a parser with `--data` and `--json`; `holds` says what the folder has to hold."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument(
        "--data",
        default=os.environ.get("CODED_APERTURE_DATA"),
        help=f"folder that holds {holds} (default: $CODED_APERTURE_DATA)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    return parser


def data_folder(parser: argparse.ArgumentParser, args: argparse.Namespace) -> Path:
    """Return the folder of the data, or end the program with its usage."""
    if args.data is None:
        parser.error("say where the data are: --data, or set CODED_APERTURE_DATA")
    return Path(args.data)


def exit_status(work: Callable[[], None]) -> int:
    """Do the work; return 0, or 1 after one line about data that cannot be used."""
    try:
        work()
    except (InputError, OSError) as error:
        print(f"{Path(sys.argv[0]).stem}: error: {error}", file=sys.stderr)
        return 1
    return 0


def print_rows(rows: Iterable[Row], as_json: bool, across: bool = True) -> None:
    """Print rows as JSON, or as a Markdown table: a line each, or a column each."""
    rows = list(rows)
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    if across:
        lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    else:
        lines = [[name, *(row[name] for row in rows)] for name in rows[0]]
    for line in lines:
        print("| " + " | ".join(map(str, line)) + " |")
