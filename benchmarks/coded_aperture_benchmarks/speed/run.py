"""All that is measured of speed, in short steps, and what came of it."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from coded_aperture_benchmarks.speed.accuracy import StairAccuracy
from coded_aperture_benchmarks.speed.baselines import (
    NonLocalMeans,
    ThesisFilters,
    graph_cut_results,
    ways_to_regularise,
)
from coded_aperture_benchmarks.speed.frames import NOISE, moving_frames
from coded_aperture_benchmarks.speed.grid import SpeedGrid
from coded_aperture_benchmarks.speed.machine import Rates, machine_rates, roofline
from coded_aperture_benchmarks.speed.ratios import ratio
from coded_aperture_benchmarks.speed.setting import MASK, Extent, Setting
from coded_aperture_benchmarks.speed.video import VideoRun
from coded_aperture_benchmarks.speed.work import (
    ENGINE_STAGES,
    LEVEL_STAGES,
    TEMPORAL_STAGES,
    FrameWork,
    fitted_slope,
)
from coded_aperture_benchmarks.thesis.stair import blur_stack
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
from coded_aperture_ros.optics import Mask

_TURNS = 4
_MAIN_TURNS = 5

Work = Callable[[], None]


class SpeedBenchmark:
    """All measurements, as a list of short steps, and what came of them."""

    def __init__(self, setting: Setting, extent: Extent) -> None:
        self.setting, self.extent = setting, extent
        self._banks: dict[int, FilterBank] = {}
        self._rates: list[Rates] = []
        self._runs: dict[tuple[str, Any], VideoRun] = {}
        stack = blur_stack(Mask.named(MASK), setting.levels)
        self._thesis = ThesisFilters(setting, stack)
        self._denoising = NonLocalMeans(setting, stack)
        self._accuracy = StairAccuracy(setting) if extent.accuracy else None
        self._grid = SpeedGrid(setting, extent.frames, extent.quick)

    def steps(self) -> list[Work]:
        """Return the work, to be done in this order; `results` is of all of it."""
        setting, extent = self.setting, self.extent
        main = [partial(self._measure, ("main", None), extent.frames)] * _MAIN_TURNS
        sizes: list[Any] = [("size", size) for size in extent.sizes]
        levels: list[Any] = [("levels", count) for count in extent.levels]
        threads: list[Any] = [("threads", count) for count in extent.threads]
        thesis = [self._thesis.measure_filters, self._thesis.measure_places]
        slow: list[Work] = thesis * extent.repeats
        if setting.temporal_frames:
            for count in extent.denoised:
                slow += [partial(self._denoising.measure, count)] * extent.repeats
        cuts: list[Any] = [("regularize", how) for how in ways_to_regularise()]
        return [
            *(partial(self._learn, count) for count in sorted({setting.levels, *extent.levels})),
            self._measure_rates,
            *main,
            self._measure_rates,
            *(step for keys in (sizes, levels, threads, cuts) for step in self._in_turns(keys)),
            *slow,
            *(self._accuracy.steps() if self._accuracy else []),
            *self._grid.steps(),
        ]

    def results(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON; keys end in their unit where there is one."""
        return {
            "setting": dataclasses.asdict(self.setting) | {"mask": MASK, "noise": NOISE},
            "machine": dataclasses.asdict(self._machine()) | {"processors": processors()},
            "main": self._main_results(),
            "sizes": self._size_results(),
            "levels": self._level_results(),
            "threads": self._thread_results(),
            "comparison": self._comparison(),
            "accuracy": self._accuracy.results() if self._accuracy else None,
            "grid": self._grid.results(self._machine()),
        }

    # The work.

    def _learn(self, levels: int) -> None:
        mask = Mask.named(MASK)
        stack = blur_stack(mask, levels)
        self._banks[levels] = learn_bank(stack, self.setting.learn_config, mask=mask)

    def _measure_rates(self) -> None:
        self._rates.append(machine_rates(self.setting.threads))

    def _in_turns(self, keys: Sequence[tuple[str, Any]]) -> list[Work]:
        """Share the frames of some runs among turns."""
        turns = min(_TURNS, self.extent.frames)
        counts = [len(part) for part in np.array_split(np.arange(self.extent.frames), turns)]
        steps: list[Work] = [partial(self._measure, key, n) for n in counts for key in keys]
        return [*steps, partial(self._close, keys)]

    def _measure(self, key: tuple[str, Any], frames: int) -> None:
        if key not in self._runs:
            self._runs[key] = self._new_run(*key)
        self._runs[key].measure(frames)

    def _close(self, keys: Sequence[tuple[str, Any]]) -> None:
        for key in keys:
            self._runs[key].close()

    def _new_run(self, kind: str, value: Any) -> VideoRun:
        setting, changes = self.setting, {}
        if kind in ("levels", "threads", "size"):
            setting = dataclasses.replace(setting, **{kind: value})
        elif kind == "regularize":
            changes = {"regularize": value}
        bank = self._banks[setting.levels]
        return VideoRun(bank, moving_frames(bank.stack, setting.size), setting, **changes)

    # What came of it.

    def _machine(self) -> Rates:
        """Return the best of the rates: those between which other work disturbed least."""
        best = {
            name: max(getattr(rates, name) for rates in self._rates)
            for name in ("gemm_gflop_s", "copy_gb_s")
        }
        medians = {
            name: float(np.median([getattr(rates, name) for rates in self._rates]))
            for name in ("gemm_p50_gflop_s", "copy_p50_gb_s")
        }
        return Rates(threads=self.setting.threads, **best, **medians)

    def _main_results(self) -> dict[str, Any]:
        run, machine = self._runs["main", None], self._machine()
        work = FrameWork.of(self._banks[self.setting.levels], self.setting, run.shape, run.map_size)
        engine, total = run.stage_times(*ENGINE_STAGES), run.times()
        engine_bytes, all_bytes = (
            work.bytes_of(stages) for stages in (ENGINE_STAGES, list(work.stage_bytes))
        )
        return {
            "size": run.shape,
            "map_size": run.map_size,
            "stages": {stage: dataclasses.asdict(run.stage_times(stage)) for stage in run.stages},
            "engine": dataclasses.asdict(engine),
            "total": dataclasses.asdict(total),
            "frames_per_second": {
                "p50": 1000 / total.p50_ms,
                "sustained": len(run.totals) / sum(run.totals),
            },
            "memory": dataclasses.asdict(run.memory) if run.memory else None,
            "per_pixel": work.per_pixel(),
            "roofline": None
            if self._on_gpu()
            else {
                "engine": dataclasses.asdict(
                    roofline(work.flop, engine_bytes, machine, engine.p50_ms)
                ),
                "frame": dataclasses.asdict(roofline(work.flop, all_bytes, machine, total.p50_ms)),
            },
        }

    def _on_gpu(self) -> bool:
        """Return whether a GPU computes, about which the rates of the processor say nothing."""
        setting = self.setting
        side = setting.window_px
        likelihood = self._banks[setting.levels].plan(
            (side, side), setting.stride_px, setting.backend
        )
        likelihood.close()
        return likelihood.backend == "cuda"

    def _size_results(self) -> dict[str, Any]:
        sizes = self.extent.sizes
        runs = [self._runs["size", size] for size in sizes]
        pixels = [float(size[0] * size[1]) for size in sizes]
        totals = [run.times().p50_ms for run in runs]
        engines = [run.stage_times(*ENGINE_STAGES).p50_ms for run in runs]
        first = totals[0] / pixels[0]
        return {
            "slope": fitted_slope(pixels, totals),
            "slope_engine": fitted_slope(pixels, engines),
            "rows": [
                {
                    "size": run.shape,
                    "map_size": run.map_size,
                    "total": dataclasses.asdict(run.times()),
                    "engine_p50_ms": engine,
                    "time_per_pixel_relative": total / count / first,
                }
                for run, total, engine, count in zip(runs, totals, engines, pixels, strict=True)
            ],
        }

    def _level_results(self) -> dict[str, Any]:
        counts = [float(count) for count in self.extent.levels]
        runs = [self._runs["levels", count] for count in self.extent.levels]
        totals = [run.times().p50_ms for run in runs]
        of_levels = [
            run.stage_times(*(s for s in LEVEL_STAGES if s in run.stages)).p50_ms for run in runs
        ]
        return {
            "exponent": fitted_slope(counts, totals),
            "exponent_of_level_stages": fitted_slope(counts, of_levels),
            "rows": [
                {
                    "levels": count,
                    "total": dataclasses.asdict(run.times()),
                    "level_stages_p50_ms": stages_ms,
                }
                for count, run, stages_ms in zip(self.extent.levels, runs, of_levels, strict=True)
            ],
        }

    def _thread_results(self) -> dict[str, Any]:
        runs = [self._runs["threads", count] for count in self.extent.threads]
        first, first_engine = runs[0].times(), runs[0].stage_times(*ENGINE_STAGES)
        return {
            "rows": [
                {
                    "threads": count,
                    "total": dataclasses.asdict(run.times()),
                    "speedup": ratio(first, run.times()),
                    "speedup_engine": ratio(first_engine, run.stage_times(*ENGINE_STAGES)),
                }
                for count, run in zip(self.extent.threads, runs, strict=True)
            ]
        }

    def _comparison(self) -> dict[str, Any]:
        run = self._runs["main", None]
        temporal = self.setting.temporal_frames
        regularising = {
            how: self._runs["regularize", how].stage_times("decode") for how in ways_to_regularise()
        }
        return {
            "thesis": self._thesis.results(run.stage_times(*ENGINE_STAGES)),
            "denoising": (
                self._denoising.results(run.stage_times(*TEMPORAL_STAGES)) if temporal else None
            ),
            "graph_cut": graph_cut_results(regularising),
        }
