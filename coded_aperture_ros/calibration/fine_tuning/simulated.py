"""Frames that are simulated with a bank's PSFs, kept in a folder."""

import itertools
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.fine_tuning.cells import BLUR_STEP, CELLS, padded
from coded_aperture_ros.calibration.fine_tuning.frames import Frame
from coded_aperture_ros.calibration.psf.simulated import simulated_frames
from coded_aperture_ros.core.archive import read_archive, write_archive
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.processes import ProcessPool, end_with_program
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.decoders.network import NetworkDecoder
from coded_aperture_ros.depth.decoders.network.cells import Cells
from coded_aperture_ros.depth.stages.decode import Decode
from coded_aperture_ros.likelihood.bank import FilterBank

# Number of the first scene: no other use has these.
_FIRST_SCENE = 100_000
_SAID_S = 30.0
_SCHEMA = "coded-aperture training"
_VERSION = 1


def claim(folder: Path, bank: FilterBank) -> None:
    """Make the folder of frames for a bank, or check that it is of this bank.

    Raises
    ------
    InputError
        If it is of another one.
    """
    path = folder / "bank.npz"
    stack = bank.stack
    settings: dict[str, NDArray[Any]] = {
        "psfs": stack.psfs if stack.channel_psfs is None else stack.channel_psfs,
        "sizes_px": stack.blur_sizes_px,
        "filters": np.array([bank.window_px, bank.stride_px, bank.highest_frequency, bank.noise]),
    }
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_archive(path, _SCHEMA, _VERSION, settings)
    found = read_archive(path, _SCHEMA, _VERSION)
    if not all(np.array_equal(found.get(name, ()), each) for name, each in settings.items()):
        raise InputError(f"{folder}: of a training for another bank: remove it to begin anew")


def made_frames(
    bank: FilterBank, seconds: float, folder: Path, say: Callable[[str], None]
) -> Iterator[Frame]:
    """Yield frames that are there, and new ones until so many seconds are spent on them in all.

    Parameters
    ----------
    bank : FilterBank
        That the refinement supports.
    seconds : float
    folder : Path
        Of the frames; see `claim`.
    say : callable
        Called with a line now and then.
    """
    paths = sorted(folder.glob("frame_*.npz"))
    spent_s = 0.0
    for path in paths:
        arrays = read_archive(path, _SCHEMA, _VERSION)
        spent_s += float(arrays["seconds"])
        yield _frame_of(arrays)
    if spent_s >= seconds:
        return
    first = 1 + max((int(path.stem.split("_")[1]) for path in paths), default=-1)
    began = time.perf_counter()
    last = said = began
    for made, (scene, index, arrays) in enumerate(_new_frames(bank, first), 1):
        now = time.perf_counter()
        arrays["seconds"], last = np.array(now - last), now
        write_archive(folder / f"frame_{scene}_{index}.npz", _SCHEMA, _VERSION, arrays)
        yield _frame_of(arrays)
        if now - said > _SAID_S:
            spent = spent_s + now - began
            say(f"{spent / 60:.1f} of {seconds / 60:.1f} min: {made} frames simulated")
            said = now
        if spent_s + now - began >= seconds:
            return


def _new_frames(bank: FilterBank, first: int) -> Iterator[tuple[int, int, dict[str, NDArray[Any]]]]:
    """Yield frames of scenes from a number on, without an end: scene, index, arrays."""
    scenes, count = itertools.count(first), processors()
    if count == 1:
        _set_up(bank)
        for scene in scenes:
            for index, arrays in enumerate(_scene_frames(scene)[1]):
                yield scene, index, arrays
    # Processes, because much of the drawing of scenes is Python.
    with ProcessPool(count, _set_up, (bank,)) as pool:
        waiting = {pool.submit(_scene_frames, next(scenes)) for _ in range(count)}
        try:
            while True:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                waiting |= {pool.submit(_scene_frames, next(scenes)) for _ in done}
                for one in done:
                    scene, found = one.result()
                    for index, arrays in enumerate(found):
                        yield scene, index, arrays
        except BrokenProcessPool as error:
            raise InputError(
                "--train: a process that simulates frames died, perhaps for lack of memory"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


# Of a process that simulates frames; see `_set_up`.
_ESTIMATORS: list[DepthEstimator] = []


def _set_up(bank: FilterBank) -> None:
    """Prepare a process for the frames of a bank."""
    end_with_program()
    if multiprocessing.parent_process() is not None:
        # A terminal sends Ctrl-C to all processes: the program answers it for them.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    config = DepthConfig(confidence_threshold=0.0, check_fit=False, threads=1)
    _ESTIMATORS[:] = [DepthEstimator(bank, config)]


def _scene_frames(scene: int) -> tuple[int, list[dict[str, NDArray[Any]]]]:
    """Frames of a scene, as the refinement is given them, with their true blur sizes."""
    estimator = _ESTIMATORS[0]
    bank = estimator.source_model
    assert isinstance(bank, FilterBank)
    frames = []
    for frame, level in simulated_frames(bank, _FIRST_SCENE + scene):
        work = estimator.run_front(frame)
        decode = estimator.back(work.frame.shape)[0]
        assert isinstance(decode, Decode) and isinstance(decode.decoder, NetworkDecoder)
        cells = Cells.covering(work.grey.shape, work.observation.grid)
        costs, around = decode.decoder.inputs(work.observation, work.volume, work.frame_cost, cells)
        blur_px = np.interp(level, np.arange(bank.levels), bank.blur_sizes_px)
        steps = np.clip(np.rint(np.abs(blur_px) / BLUR_STEP), 1, np.iinfo(np.int16).max)
        frames.append(
            {
                "costs": padded(costs, CELLS),
                "frame": padded(around, 2 * CELLS),
                "tried": decode.decoder.tried,
                "blur": steps.astype(np.int16),
                "corner": np.array([cells.top, cells.left]),
            }
        )
    return scene, frames


def _frame_of(arrays: Mapping[str, NDArray[Any]]) -> Frame:
    names = ("costs", "frame", "tried", "blur", "corner")
    return Frame(**{name: arrays[name] for name in names}, infinity_px=0.0, rare=True)
