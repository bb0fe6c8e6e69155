"""Results that go into a folder, as numbers and figures, and are printed."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.core.errors import InputError

RESULTS = "results.json"


def check_results_folder(args: argparse.Namespace) -> None:
    """Refuse, before anything is computed, an `--output` that cannot be written."""
    if args.output is None:
        return
    folder = Path(args.output)
    if folder.is_file():
        raise InputError(f"cannot write {folder}: it is a file, expected a folder")
    check_output(folder / RESULTS)
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            "--output: figures need matplotlib: pip install matplotlib, or use --json"
        ) from error


def write_results(
    args: argparse.Namespace,
    results: dict[str, Any],
    text: Callable[[dict[str, Any]], str],
    draw: Callable[[Path], None],
) -> int:
    """Write results into the folder of `--output`, print them, and return the exit status.

    Parameters
    ----------
    results : dict
        For JSON, where numbers that are not finite become null.
    text : callable
        From the results to what is printed without `--json`.
    draw : callable
        Writes figures into a folder.
    """
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.design.page import finite

    as_json = json.dumps(finite(results), indent=1, allow_nan=False)
    if args.output is not None:
        folder = Path(args.output)
        with atomic_output(folder / RESULTS) as path:
            path.write_text(as_json + "\n")
        draw(folder)
    print(as_json if args.json else text(results))
    if args.output is not None and not args.json:
        print(f"figures and {RESULTS}: {args.output}")
    return 0
