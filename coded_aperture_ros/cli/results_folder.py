"""Results that go into a folder, as numbers and figures, and are printed."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output, check_output
from coded_aperture_ros.design.page import finite

RESULTS = "results.json"


def check_results_folder(folder: Path | None) -> None:
    """Refuse, before anything is computed, a folder that cannot be written."""
    if folder is None:
        return
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
    results: dict[str, Any],
    text: Callable[[dict[str, Any]], str],
    draw: Callable[[Path], None],
    folder: Path | None,
    *,
    as_json: bool,
) -> int:
    """Write results into a folder, if there is one, and print them; return the exit status.

    Parameters
    ----------
    results : dict
        For JSON, where numbers that are not finite become null.
    text : callable
        From the results to what is printed without `--json`.
    draw : callable
        Writes figures into a folder.
    folder : Path or None
    as_json : bool
        Whether JSON is printed instead of text.
    """
    written = json.dumps(finite(results), indent=1, allow_nan=False)
    if folder is not None:
        with atomic_output(folder / RESULTS) as path:
            path.write_text(written + "\n")
        draw(folder)
    print(written if as_json else text(results))
    if folder is not None and not as_json:
        print(f"figures and {RESULTS}: {folder}")
    return 0
