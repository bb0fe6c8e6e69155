"""Depth as nodes estimate it, over distances between patches, frame sizes, grey and colour."""

import dataclasses
import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.speed.frames import moving_frames
from coded_aperture_benchmarks.speed.machine import Rates
from coded_aperture_benchmarks.speed.setting import MASK, Setting, Size
from coded_aperture_benchmarks.speed.video import VideoRun
from coded_aperture_benchmarks.speed.work import ENGINE_STAGES, flop_of_hypotheses, flop_of_spectra
from coded_aperture_ros.depth.decoders.network import choose_decoder
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.likelihood import Plan
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack

# Smallest and largest blur, px, and the number of levels between.
BLUR_PX = (2.0, 15.0, 27)
STRIDES_PX, QUICK_STRIDES_PX = (4, 8, 12, 16, 24), (8, 16)
SIZES: tuple[Size, ...] = ((240, 320), (480, 640), (720, 1280))
QUICK_SIZES = SIZES[:1]
WAYS = ("semiglobal", LEARNED)

Work = Callable[[], None]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One row of the table."""

    stride_px: int
    size: Size
    colour: bool
    regularize: str


class SpeedGrid:
    """Measures every cell in turns, with the bank that `learn` makes by default.

    Full-size maps; single frames, as memory of a video costs the same everywhere. Of `setting`
    threads and backend count. Cells that the network was not trained for are left out.
    """

    def __init__(self, setting: Setting, frames: int, quick: bool) -> None:
        self._setting, self._frames = setting, frames
        strides, sizes = (QUICK_STRIDES_PX, QUICK_SIZES) if quick else (STRIDES_PX, SIZES)
        self.cells = [
            Cell(*cell) for cell in itertools.product(strides, sizes, (False, True), WAYS)
        ]
        self._bank: FilterBank | None = None
        self._rows: list[dict[str, Any]] = []

    def steps(self) -> list[Work]:
        """Return the work, to be done in this order."""
        return [self._learn, *(partial(self._measure, cell) for cell in self.cells)]

    def results(self, machine: Rates) -> list[dict[str, Any]]:
        """Return the rows; the engine's share is of what the machine does in matrix products."""
        for row in self._rows:
            attained = row["engine_gflop"] / (row["engine_p50_ms"] / 1e3) / machine.gemm_gflop_s
            row["engine_of_gemm"] = attained
        return self._rows

    def _learn(self) -> None:
        mask = Mask.named(MASK)
        self._bank = learn_bank(render_psf_stack(mask, np.linspace(*BLUR_PX)), mask=mask)

    def _measure(self, cell: Cell) -> None:
        bank = self._bank
        if bank is None:
            raise RuntimeError("the bank has not been learned")
        if choose_decoder(bank, cell.regularize, cell.stride_px).reason:
            return
        setting = dataclasses.replace(
            self._setting, stride_px=cell.stride_px, temporal_frames=0.0, full_size=True
        )
        frames = moving_frames(bank.stack, cell.size)
        if cell.colour:
            frames = [_coloured(frame) for frame in frames]
        run = VideoRun(bank, frames, setting, regularize=cell.regularize)
        run.measure(self._frames)
        run.close()
        plan = Plan.for_frames(bank, cell.size, cell.stride_px)
        total = run.times()
        self._rows.append(
            {
                **dataclasses.asdict(cell),
                "stages": {stage: run.stage_times(stage).p50_ms for stage in run.stages},
                "total": dataclasses.asdict(total),
                "frames_per_second": 1000 / total.p50_ms,
                "engine_p50_ms": run.stage_times(*ENGINE_STAGES).p50_ms,
                "engine_gflop": (flop_of_spectra(plan) + flop_of_hypotheses(plan)) / 1e9,
            }
        )


def _coloured(frame: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.ascontiguousarray(frame[..., None] * np.array([1.0, 0.9, 0.8], np.float32))
