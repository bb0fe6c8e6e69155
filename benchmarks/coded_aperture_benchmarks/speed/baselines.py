"""What other methods take for the same: the thesis' filters, non-local means, graph cuts."""

import dataclasses
import time
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.speed.frames import NOISE, moving_frames
from coded_aperture_benchmarks.speed.machine import opencv_threads
from coded_aperture_benchmarks.speed.ratios import ratio
from coded_aperture_benchmarks.speed.setting import Setting
from coded_aperture_benchmarks.thesis.reference.subspace import SubspaceBank, SubspaceLikelihood
from coded_aperture_ros.core.machine import seconds_in_threads
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import PsfStack

# Thesis 8.3.1.
_FILTERS = 150
_BASIS = 200
_PATCH_PX = 33
_FILTERS_TRIED = 2
_TRIES = 3
# Pixel positions at which one thread tries the levels.
_PLACES = (24, 64)


class ThesisFilters:
    """The thesis' filters at every pixel, one by one and from a common basis; extrapolated.

    Parameters
    ----------
    stack : PsfStack
        The levels.
    """

    def __init__(self, setting: Setting, stack: PsfStack) -> None:
        self._setting, self._stack = setting, stack
        self._filter_s: list[float] = []
        self._place_s: list[float] = []

    def measure_filters(self) -> None:
        """Convolve the frame with a few of the filters, and sum their squares.

        OpenCV does that by Fourier transforms where filters are as large as these.
        """
        threads = self._setting.threads
        random = np.random.default_rng(0)
        frame = random.random(self._setting.size, dtype=np.float32)
        kernel = random.standard_normal((_PATCH_PX, _PATCH_PX)).astype(np.float32)
        sums = [np.zeros_like(frame) for _ in range(threads)]

        def convolve(thread: int) -> None:
            for _ in range(_FILTERS_TRIED):
                cv2.accumulateSquare(cv2.filter2D(frame, cv2.CV_32F, kernel), sums[thread])

        with opencv_threads(1):  # each of our threads has its own filters
            self._filter_s += seconds_in_threads(convolve, threads, _TRIES)

    def measure_places(self) -> None:
        """Find the energies of some places from a common basis as large as the thesis'."""
        likelihood, projections = _some_subspaces(self._stack)

        def energies(thread: int) -> None:
            likelihood.energies_of(projections, NOISE)

        self._place_s += seconds_in_threads(energies, self._setting.threads, _TRIES)

    def results(self, engine: Times) -> dict[str, Any]:
        """Compare with the times of the stages that do the same here."""
        setting = self._setting
        filters = setting.levels * _FILTERS
        tried = _FILTERS_TRIED * setting.threads
        pixels = setting.size[0] * setting.size[1]
        places = _PLACES[0] * _PLACES[1] * setting.threads
        grid = PatchGrid.covering(setting.size, setting.window_px, setting.stride_px)
        density = pixels / (grid.rows * grid.columns)
        unfactored = Times.from_seconds(self._filter_s, filters / tried)
        basis_s = np.multiply(self._filter_s, _BASIS / tried)
        levels_s = np.multiply(self._place_s, pixels / places)
        factored = Times.from_seconds((basis_s + levels_s).tolist())

        def against(times: Times) -> dict[str, Any]:
            slower = ratio(times, engine)
            per_place = {name: value / density for name, value in slower.items()}
            return {"ratio": slower, "ratio_per_place": per_place}

        return {
            "engine": dataclasses.asdict(engine),
            "pixels_per_patch": density,
            "unfactored": {
                "extrapolated": f"from {tried} filters on the whole frame to {filters}",
                "filters": filters,
                "times": dataclasses.asdict(unfactored),
                **against(unfactored),
            },
            "common_basis": {
                "extrapolated": (
                    f"from {tried} filters on the whole frame to {_BASIS}, and from the "
                    f"energies of {places} pixels to {pixels}"
                ),
                "filters": _BASIS,
                "filters_p50_ms": 1000 * float(np.median(basis_s)),
                "energies_p50_ms": 1000 * float(np.median(levels_s)),
                "times": dataclasses.asdict(factored),
                **against(factored),
            },
        }


class NonLocalMeans:
    """OpenCV's non-local means of some frames, instead of the mean where nothing moves.

    Parameters
    ----------
    stack : PsfStack
        The levels.
    """

    def __init__(self, setting: Setting, stack: PsfStack) -> None:
        self._setting, self._stack = setting, stack
        self._seconds: dict[int, list[float]] = {}

    def measure(self, count: int) -> None:
        """Denoise one frame with the help of those around it, `count` in all."""
        frames = moving_frames(self._stack, self._setting.size, count)
        pictures = [np.rint(255 * frame).astype(np.uint8) for frame in frames]
        with opencv_threads(self._setting.threads):
            start = time.perf_counter()
            cv2.fastNlMeansDenoisingMulti(pictures, count // 2, count)
            self._seconds.setdefault(count, []).append(time.perf_counter() - start)

    def results(self, own: Times) -> dict[str, Any]:
        """Compare with the times of the temporal stages."""
        rows = []
        for count, seconds in self._seconds.items():
            times = Times.from_seconds(seconds)
            rows.append(
                {"frames": count, "times": dataclasses.asdict(times), "ratio": ratio(times, own)}
            )
        return {"still_and_temporal": dataclasses.asdict(own), "non_local_means": rows}


def ways_to_regularise() -> tuple[str, ...]:
    """Return what is compared: graph cuts only where they are installed."""
    return ("semiglobal", "graphcut") if find_spec("maxflow") else ("semiglobal",)


def graph_cut_results(times: Mapping[str, Times]) -> dict[str, Any] | None:
    """Compare the times of the ways to regularise; None without graph cuts."""
    if "graphcut" not in times:
        return None
    return {
        "semiglobal": dataclasses.asdict(times["semiglobal"]),
        "graphcut": dataclasses.asdict(times["graphcut"]),
        "ratio": ratio(times["graphcut"], times["semiglobal"]),
    }


def _some_subspaces(stack: PsfStack) -> tuple[SubspaceLikelihood, NDArray[np.float32]]:
    """Return filters of the thesis' size and projections: what the numbers are takes no time."""
    random = np.random.default_rng(0)
    size = (_BASIS, _BASIS)
    form = random.standard_normal(size).astype(np.float32)
    bank = SubspaceBank(
        stack=stack,
        patch_px=_PATCH_PX,
        rank=_FILTERS,
        basis=np.zeros((_PATCH_PX**2, _BASIS), np.float32),
        forms=np.broadcast_to(form, (len(stack), *size)),
        truncation_error=0.0,
        noise=0.0,
        mask_digest="",
        learned_from="nothing",
    )
    shape = tuple(side + _PATCH_PX for side in _PLACES)
    projections = random.standard_normal((*_PLACES, _BASIS)).astype(np.float32)
    return bank.plan(shape, 1), projections
