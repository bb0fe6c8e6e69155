"""`coded_aperture mask search`: masks with less depth and deblurring error."""

import dataclasses
import logging
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.cli.command import Command, argument, group
from coded_aperture_ros.cli.results import Summary, print_summary
from coded_aperture_ros.core.arrays import BoolArray
from coded_aperture_ros.core.cluster import dask_client
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import check_output
from coded_aperture_ros.core.processes import ProcessPool
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.checkpoint import load_checkpoint, save_checkpoint
from coded_aperture_ros.design.search.search import (
    SearchConfig,
    SearchState,
    first_state,
    run_epoch,
    search_epochs,
)
from coded_aperture_ros.io import write_image

_EXAMPLES = """examples:
  a mask of 11x11 cells, for a minute or two; it goes on where it stood if it is started again:
    coded_aperture mask search --checkpoint search.npz -o mask.png
  a short search for a mask to be cut out of cardboard, with openings of at least 2x2 cells:
    coded_aperture mask search --cells 10 --smallest-opening 2 --carrier connected \\
        --islands 1 --epochs 2 --generations 5 -o cardboard.png
  on the workers of a Dask scheduler:
    coded_aperture mask search --islands 32 --epochs 200 --scheduler tcp://host:8786 -o mask.png
"""
RunAll = Callable[[list[tuple[Any, ...]]], list[Any]]
_SHOWN = 8


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `mask search`."""

    output: str | None = argument(
        "picture of the best mask to write (.png or .npy)",
        None,
        written="-o --output FILE",
        is_output=True,
    )
    checkpoint: Path | None = argument(
        "file that the search is saved to after every round, and goes on from",
        None,
        written="--checkpoint NPZ",
        is_output=True,
    )
    scheduler: str | None = argument(
        "Dask scheduler whose workers share the search, instead of processes here",
        None,
        written="--scheduler ADDRESS",
    )
    jobs: int = argument(
        "processes (default: one for each processor)", processors(), written="--jobs N", minimum=1
    )
    json: bool = argument("print the Pareto front as JSON", False)
    search: SearchConfig = group("which masks, and how long", SearchConfig())
    scene: SceneConfig = group("what the mask has to tell apart", SceneConfig())


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    config = args.search
    scene = args.scene
    if args.output is not None:
        check_output(args.output, suffixes=(".png", ".npy"))
    state = None
    if args.checkpoint is not None:
        check_output(args.checkpoint, suffixes=[".npz"])
        if args.checkpoint.exists():
            state = load_checkpoint(args.checkpoint, config, scene)
            logging.info("%s: going on after round %d", args.checkpoint, state.epoch)
    state = state or first_state(config)
    workers = _dask_workers(args.scheduler) if args.scheduler else _local_processes(args.jobs)
    with workers as run_all:
        left = config.epochs - state.epoch
        for reached in progress(search_epochs(config, scene, run_all, state), left, "round"):
            state = reached
            if args.checkpoint is not None:
                save_checkpoint(args.checkpoint, state, config, scene)
    if args.output is not None:
        write_image(args.output, state.best.astype(np.float32), gamma=1.0)
    return print_summary(_summary(state), _text, as_json=args.json)


@contextmanager
def _local_processes(jobs: int) -> Iterator[RunAll]:
    """Yield what runs the epochs of all islands in processes; with one job, in this one."""
    if jobs == 1:
        yield lambda tasks: [_run(task) for task in tasks]
        return
    pool = ProcessPool(jobs)
    try:
        yield lambda tasks: list(pool.map(_run, tasks))
    except BrokenProcessPool as error:
        raise InputError(
            "a process of the search ended by itself, perhaps for lack of memory: use fewer "
            "--jobs; with --checkpoint the search goes on where it stood"
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def _dask_workers(address: str) -> Iterator[RunAll]:
    """Yield what runs the epochs of all islands on the workers of a Dask scheduler.

    A worker that dies loses nothing: an epoch depends only on its arguments, which this process
    keeps, and the scheduler gives it to another worker.
    """
    with dask_client(address) as client:
        yield lambda tasks: client.gather(client.map(_run, tasks, pure=False, retries=2))


def _run(task: tuple[Any, ...]) -> Any:
    return run_epoch(*task)


def _summary(state: SearchState) -> dict[str, Any]:
    front = state.front
    rows = [
        {
            "depth_error": round(float(depth), 4),
            "deblurring_error": round(float(deblurring), 4),
            "light": round(1 - float(closed), 4),
            "rows": _rows(grid),
        }
        for grid, (depth, deblurring, closed) in zip(front.grids, front.scores, strict=True)
    ]
    best = _rows(state.best)
    return {"masks_scored": state.scored, "rounds": state.epoch, "best": best, "front": rows}


def _text(found: Summary) -> str:
    lines = [
        [f"{row['depth_error']:.3f}", f"{row['deblurring_error']:.3f}", f"{row['light']:.2f}"]
        for row in found["front"][:: max(1, len(found["front"]) // _SHOWN)]
    ]
    what = f"the best of {found['masks_scored']} masks; some that are better in one respect:"
    errors = table(["depth error", "deblurring error", "light"], lines)
    return "\n".join([*found["best"], what, errors])


def _rows(grid: BoolArray) -> list[str]:
    return ["".join("#" if cell else "." for cell in row) for row in grid]


COMMAND = Command(
    Arguments,
    run,
    description="Look for masks of small predicted depth and deblurring error, by annealing "
    "and mixing populations of masks. The best is written as a picture, one pixel for each "
    "cell, which --mask and camera files take.",
    examples=_EXAMPLES,
)
