"""The one runner of all benchmarks: cells -> what was measured -> JSON, table, figure."""

import argparse
import dataclasses
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.processes import map_in_processes

RESULTS = "results.json"
# Names the folder of predictions in the environment, which other processes inherit.
PREDICTIONS = "CODED_APERTURE_PREDICTIONS"

# What options are called in the results.
_WITH_UNIT = {"side": "side_px", "window": "window_px"}

Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Suite:
    """One benchmark: its options, its cells, and what becomes of them.

    Attributes
    ----------
    name : str
    description, examples : str
        For its help.
    options : sequence of callable
        Each adds options to an `argparse.ArgumentParser`; see `options`.
    cells : callable
        From the options to what is measured, one by one. Refuses first what cannot be measured:
        with `args.usage_error`, or an `InputError` about what was read.
    measure : callable
        Measures one cell. A module's function, so that other processes can import it.
    said : sequence of str
        Options that stand in the results.
    results : callable
        From the options and what was measured, in the cells' order, to a dictionary for JSON,
        where NaN becomes null; beside the name, what is `said`, and the seconds it all took.
        Without one these are the rows: one, or several, for each cell.
    text : callable
        From that dictionary to tables.
    draw : callable, optional
        Draws what was measured into a folder. Tables that are small enough to be read have none.
    """

    name: str
    description: str
    examples: str
    options: Sequence[Callable[[argparse.ArgumentParser], None]]
    cells: Callable[[argparse.Namespace], Sequence[Any]]
    measure: Callable[[Any], Any]
    text: Callable[[Row], str]
    draw: Callable[[argparse.Namespace, list[Any], Path], None] | None = None
    said: Sequence[str] = ()
    results: Callable[[argparse.Namespace, list[Any]], Row] | None = None


def run(suite: Suite, args: argparse.Namespace) -> int:
    """Measure all cells of a suite, then write and print the results; return the exit status.

    Of the options, `predictions` names a folder that keeps depth maps, `jobs` says how many
    processes share the work (1 without it), `output` names a folder for JSON and figures, and
    `json` asks for JSON instead of tables.
    """
    cells = suite.cells(args)
    folder = _output_folder(args)
    start = time.perf_counter()
    with _predictions_in(getattr(args, "predictions", None)):
        measured = map_in_processes(suite.measure, cells, getattr(args, "jobs", 1), "cell")
    seconds = round(time.perf_counter() - start, 1)
    results = {
        "benchmark": suite.name,
        **{_WITH_UNIT.get(name, name): getattr(args, name) for name in suite.said},
        "seconds": seconds,
        **(suite.results(args, measured) if suite.results else _rows(measured)),
    }
    as_json = json.dumps(_without_nan(results), indent=1, allow_nan=False)
    if folder is not None:
        with atomic_output(folder / RESULTS) as path:
            path.write_text(as_json + "\n")
        if suite.draw is not None:
            suite.draw(args, measured, folder)
    print(as_json if args.json else suite.text(results))
    if folder is not None and not args.json:
        print(f"{'figures and ' if suite.draw else ''}{RESULTS}: {folder}")
    return 0


def _rows(measured: Sequence[Row | list[Row]]) -> Row:
    cells: list[Row] = []
    for each in measured:
        cells += each if isinstance(each, list) else [each]
    return {"cells": cells}


@contextmanager
def _predictions_in(folder: str | None) -> Iterator[None]:
    """Let all processes keep predictions in a folder, if there is one."""
    before = os.environ.get(PREDICTIONS)
    if folder is not None:
        os.environ[PREDICTIONS] = str(Path(folder).resolve())
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(PREDICTIONS, None)
        else:
            os.environ[PREDICTIONS] = before


def _output_folder(args: argparse.Namespace) -> Path | None:
    """Find out before an hour of work whether its results can be written."""
    if getattr(args, "output", None) is None:
        return None
    folder = Path(args.output)
    if folder.is_file():
        raise InputError(f"cannot write {folder}: it is a file, expected a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permissions alone do not tell: a file system may be read-only.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror or error}") from error
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            "--output: figures need matplotlib: pip install matplotlib, or use --json"
        ) from error
    return folder


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
