"""How fast depth estimation is, next to what the machine could do and to other methods.

Times are medians and 99th percentiles of frames, never means: a camera does not wait. Sizes, counts
of levels or threads, and regularisations are measured in turns among themselves, so that other work
on the machine slows all of them alike.

What counts as work:

- Operations are those of the matrix products, as `Plan` counts them. All else is counted as none.
- Bytes are estimated from the sizes of arrays: each stage takes its arrays from memory once and
  leaves its results there once. Beside these only the horizontal transform is counted, which is
  larger than a cache and kept between the two passes of the spectra. What a thread keeps for a row
  of patches, the path costs of the regularisation and the constant matrices are taken to stay in
  the caches. Both numbers are thus lower bounds, and so is the time that follows from them.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.bank import (
    FilterBank,
    LearnConfig,
    PatchGrid,
    SubspaceBank,
    learn_bank,
)
from coded_aperture_ros.bank.subspace import SubspaceFrame
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.engine import Plan
from coded_aperture_ros.evaluation.stair import blur_stack
from coded_aperture_ros.optics import Camera, Mask, PsfStack
from coded_aperture_ros.threads import processors

MASK = "levin"
NOISE = 0.003
# Best-effort messages of depth are no larger (rows, columns).
PUBLISHED = (240, 320)
ENGINE_STAGES = ("spectra", "energies")
TEMPORAL_STAGES = ("still", "temporal")
# The stages whose work grows with the levels.
LEVEL_STAGES = ("energies", "temporal", "regularise")

# Blurred by 32 px at infinity, so that every level of 7 to 30 px has a depth.
_FOCAL_LENGTH_PX, _FOCUS_M, _EXTENT_MM = 800.0, 1.0, 40.0
_VIDEO_FRAMES = 6
_STEP_PX = (1, 2)
_BANDS = 4
_SLOPE = 1.2  # of the amplitude of natural texture
_CONTRAST = 0.12
# Frames that are not measured: the first is planned for, the second begins the video.
_WARM_UP = 2
_TURNS = 4
_MAIN_TURNS = 5

_PRODUCT_SIDE = 1024
_PRODUCTS = 2
_COPY_BYTES = 128 * 2**20
_RATE_REPEATS = 5
_MIB = 2**20

# Thesis 8.3.1.
_THESIS_FILTERS = 150
_THESIS_BASIS = 200
_THESIS_PATCH_PX = 33
_FILTERS_TRIED = 2
_TRIES = 3
# Pixel positions at which one thread tries the levels.
_PLACES = (24, 64)

Size = tuple[int, int]
Work = Callable[[], None]


@dataclasses.dataclass(frozen=True)
class Setting:
    """What is measured.

    Attributes
    ----------
    size : (int, int)
        Rows and columns of the main size.
    levels : int
        From 7 to 30 px.
    window_px, rank
        Of the bank.
    stride_px : int
        Distance between patches.
    threads : int
    temporal_frames : float
        0: every frame for itself.
    full_size : bool
        Maps as large as the frame, instead of what the node publishes.
    """

    size: Size
    levels: int
    window_px: int
    rank: int
    stride_px: int
    threads: int
    temporal_frames: float
    full_size: bool


@dataclasses.dataclass(frozen=True)
class Extent:
    """How much is measured.

    Attributes
    ----------
    frames : int
        For every measurement; the main one has five times as many.
    sizes : tuple of (int, int)
        Rows and columns.
    levels, threads : tuple of int
    repeats : int
        Of the methods that are slower than this one.
    denoised : tuple of int
        Frames that a non-local mean is of.
    """

    frames: int
    sizes: tuple[Size, ...]
    levels: tuple[int, ...]
    threads: tuple[int, ...]
    repeats: int
    denoised: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Times:
    """Distribution of what one thing takes, in ms; of few samples, p99 is the worst of them."""

    samples: int
    p50_ms: float
    p99_ms: float
    worst_ms: float

    @classmethod
    def of(cls, seconds: Sequence[float], factor: float = 1.0) -> "Times":
        """Summarise times in seconds, each multiplied by a factor."""
        p50, p99, worst = 1000 * factor * np.quantile(seconds, [0.5, 0.99, 1.0])
        return cls(len(seconds), float(p50), float(p99), float(worst))

    def over(self, other: "Times") -> dict[str, float]:
        """Return how many times another's times these are."""
        return {"p50": self.p50_ms / other.p50_ms, "p99": self.p99_ms / other.p99_ms}


@dataclasses.dataclass(frozen=True)
class Rates:
    """What the machine can do with some threads: the best of a few tries, and their median.

    Attributes
    ----------
    gemm_gflop_s, gemm_p50_gflop_s : float
        float32 matrix products, 1024 x 1024, every thread its own.
    copy_gb_s, copy_p50_gb_s : float
        Bytes read plus bytes written by copying arrays of 128 MiB in all.
    """

    threads: int
    gemm_gflop_s: float
    gemm_p50_gflop_s: float
    copy_gb_s: float
    copy_p50_gb_s: float


@dataclasses.dataclass(frozen=True)
class Roofline:
    """The least time that some work takes at the machine's rates.

    Attributes
    ----------
    gflop, mb : float
        The work: 10^9 operations, 10^6 bytes.
    bound_ms : float
    limited_by : str
        `compute` or `memory`.
    attained : float
        The bound as a share of the time that was measured.
    """

    gflop: float
    mb: float
    bound_ms: float
    limited_by: str
    attained: float


@dataclasses.dataclass(frozen=True)
class FrameWork:
    """Work on one frame, counted as the module says.

    Attributes
    ----------
    pixels : int
        Of the frame.
    flop_spectra, flop_hypotheses : float
    stage_bytes : mapping of str to float
        For every stage.
    """

    pixels: int
    flop_spectra: float
    flop_hypotheses: float
    stage_bytes: Mapping[str, float]

    @classmethod
    def of(cls, bank: FilterBank, setting: Setting, shape: Size, size: Size) -> "FrameWork":
        """Count for frames of `shape` and maps of `size`, both rows and columns."""
        plan = Plan.of(bank, shape, setting.stride_px)
        floats = np.dtype(np.float32).itemsize
        patches = plan.grid.rows * plan.grid.columns
        frame = floats * shape[0] * shape[1]
        horizontal = floats * plan.pixel_rows * len(plan.horizontal) * plan.grid.columns
        functions = floats * patches * len(plan.features)
        evidence = floats * patches * bank.levels
        maps = 4 * floats * size[0] * size[1]  # level, blur size, depth, confidence
        stages = {
            "prepare": frame,
            "still": 3 * frame,  # with the mean, before and after
            "spectra": frame + 2 * horizontal + functions,
            "energies": frame + functions + evidence,  # with the noise of the frame
            "temporal": 4 * evidence,  # with that of the past, before and after
            "regularise": evidence,
            "map": evidence + maps,
        }
        if not setting.temporal_frames:
            stages = {name: count for name, count in stages.items() if name not in TEMPORAL_STAGES}
        return cls(
            pixels=shape[0] * shape[1],
            flop_spectra=plan.flop_per_frame,
            flop_hypotheses=plan.flop_of_hypotheses(len(bank.prior.contrasts), len(bank.ratios)),
            stage_bytes={name: float(count) for name, count in stages.items()},
        )

    @property
    def flop(self) -> float:
        """Operations of the frame."""
        return self.flop_spectra + self.flop_hypotheses

    def bytes_of(self, stages: Sequence[str]) -> float:
        """Return the bytes that some stages move."""
        return sum(self.stage_bytes[name] for name in stages)

    def per_pixel(self) -> dict[str, Any]:
        """Return operations and bytes per pixel of the frame."""
        return {
            "flop": {
                "spectra": self.flop_spectra / self.pixels,
                "hypotheses": self.flop_hypotheses / self.pixels,
                "total": self.flop / self.pixels,
            },
            "bytes": {name: count / self.pixels for name, count in self.stage_bytes.items()}
            | {
                "engine": self.bytes_of(ENGINE_STAGES) / self.pixels,
                "total": self.bytes_of(list(self.stage_bytes)) / self.pixels,
            },
        }


@dataclasses.dataclass(frozen=True)
class Memory:
    """Resident memory of the process, 2^20 bytes; NaN where the system does not tell.

    Attributes
    ----------
    peak_mib : float
        The most while frames were measured.
    planned_mib : float
        What came with planning and the first frame.
    growth_mib : float
        From there to the end; of a leak it would be a multiple of the frames.
    """

    peak_mib: float
    planned_mib: float
    growth_mib: float


def published_size(shape: Size, full: bool = False) -> Size:
    """Return the size (rows, columns) of the map that a node publishes for frames of a shape.

    The largest whole fraction within 320x240, or the frame's own.
    """
    divisor = 1 if full else max(-(-shape[0] // PUBLISHED[0]), -(-shape[1] // PUBLISHED[1]), 1)
    return max(1, shape[0] // divisor), max(1, shape[1] // divisor)


def fitted_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the exponent ``s`` of ``y = c x^s``, by least squares of the logarithms."""
    return float(np.polynomial.Polynomial.fit(np.log(x), np.log(y), 1).convert().coef[1])


def roofline(flop: float, moved_bytes: float, rates: Rates, measured_ms: float) -> Roofline:
    """Compare a time with the least that the machine's rates allow."""
    compute_ms = flop / rates.gemm_gflop_s / 1e6
    memory_ms = moved_bytes / rates.copy_gb_s / 1e6
    bound = max(compute_ms, memory_ms)
    return Roofline(
        gflop=flop / 1e9,
        mb=moved_bytes / 1e6,
        bound_ms=bound,
        limited_by="compute" if compute_ms >= memory_ms else "memory",
        attained=bound / measured_ms,
    )


def machine_rates(threads: int) -> Rates:
    """Measure what a number of threads can do.

    BLAS has to use one thread itself (``OPENBLAS_NUM_THREADS=1``).
    """
    random = np.random.default_rng(0)
    side = (_PRODUCT_SIDE, _PRODUCT_SIDE)
    factor = random.random(side, dtype=np.float32)
    products = [np.empty_like(factor) for _ in range(threads)]
    sources = [np.ones(_COPY_BYTES // 4 // threads, np.float32) for _ in range(threads)]
    targets = [np.zeros_like(source) for source in sources]

    def multiply(thread: int) -> None:
        for _ in range(_PRODUCTS):
            np.matmul(factor, factor, out=products[thread])

    def copy(thread: int) -> None:
        np.copyto(targets[thread], sources[thread])

    flop = 2.0 * _PRODUCT_SIDE**3 * _PRODUCTS * threads
    moved = 2.0 * sum(source.nbytes for source in sources)
    gemm_s = _seconds_in_threads(multiply, threads, _RATE_REPEATS)
    copy_s = _seconds_in_threads(copy, threads, _RATE_REPEATS)
    return Rates(
        threads=threads,
        gemm_gflop_s=flop / min(gemm_s) / 1e9,
        gemm_p50_gflop_s=flop / float(np.median(gemm_s)) / 1e9,
        copy_gb_s=moved / min(copy_s) / 1e9,
        copy_p50_gb_s=moved / float(np.median(copy_s)) / 1e9,
    )


def _seconds_in_threads(work: Callable[[int], None], threads: int, repeats: int) -> list[float]:
    """Return how long threads take together, each with ``work(thread)``; once unmeasured."""
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats + 1):
            start = time.perf_counter()
            list(pool.map(work, range(threads)))
            seconds.append(time.perf_counter() - start)
    return seconds[1:]


@contextmanager
def opencv_threads(threads: int) -> Iterator[None]:
    """Let OpenCV use a number of threads for a while."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def moving_frames(
    stack: PsfStack, shape: Size, count: int = _VIDEO_FRAMES, seed: int = 0
) -> list[NDArray[np.float32]]:
    """Simulate coded frames of a textured scene that moves by a few pixels from frame to frame.

    The texture has the spectrum of photographs; bands of it lie at different levels.

    Parameters
    ----------
    stack : PsfStack
    shape : (int, int)
        Rows and columns.
    count : int
    seed : int

    Returns
    -------
    list of ndarray, float32 [rows, columns]
        In linear light around 0.5, with noise of 0.003.
    """
    random = np.random.default_rng(seed)
    rows, columns = (
        scipy.fft.next_fast_len(side + step * count, real=True)
        for side, step in zip(shape, _STEP_PX, strict=True)
    )
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)) + 1 / columns
    white = random.standard_normal((rows, columns), dtype=np.float32)
    spectrum = scipy.fft.rfft2(white) / (frequency**_SLOPE).astype(np.float32)
    scene = np.empty((rows, columns), np.float32)
    levels = np.linspace(0, len(stack) - 1, _BANDS).round().astype(int)
    for band, level in zip(np.array_split(np.arange(columns), _BANDS), levels, strict=True):
        transfer = scipy.fft.rfft2(stack.psfs[level].astype(np.float32), (rows, columns))
        scene[:, band] = scipy.fft.irfft2(spectrum * transfer, (rows, columns))[:, band]
    scene = 0.5 + _CONTRAST * (scene - scene.mean()) / scene.std()
    frames = []
    for number in range(count):
        top, left = (number * step for step in _STEP_PX)
        crop = scene[top : top + shape[0], left : left + shape[1]]
        noise = NOISE * random.standard_normal(shape, dtype=np.float32)
        frames.append(np.clip(crop + noise, 0, 0.99).astype(np.float32))
    return frames


class VideoRun:
    """Estimates the depth of a video that goes there and back, and keeps the times.

    Parameters
    ----------
    bank : FilterBank
    frames : sequence of ndarray, float32 [rows, columns]
    setting : Setting
    changes
        Of the `DepthConfig`.

    Attributes
    ----------
    totals : list of float
        Of every frame that was measured, s.
    stages : dict of str to list of float
        The same for every stage.
    memory : Memory or None
        Once frames were measured.
    """

    def __init__(
        self,
        bank: FilterBank,
        frames: Sequence[NDArray[np.float32]],
        setting: Setting,
        **changes: Any,
    ) -> None:
        config = DepthConfig(
            stride_px=setting.stride_px,
            threads=setting.threads,
            temporal_frames=setting.temporal_frames,
        )
        self.shape: Size = (frames[0].shape[0], frames[0].shape[1])
        self.map_size = published_size(self.shape, setting.full_size)
        self._frames = [*frames, *frames[-2:0:-1]]  # no jump at the end
        self._next = 0
        self._threads = setting.threads
        height, width = self.shape
        camera = Camera(_FOCAL_LENGTH_PX, _FOCUS_M, width, height, Mask.named(MASK), _EXTENT_MM)
        self._estimator = DepthEstimator(bank, dataclasses.replace(config, **changes), camera)
        self.totals: list[float] = []
        self.stages: dict[str, list[float]] = {}
        self.memory: Memory | None = None
        self._planned = (float("nan"), float("nan"))

    def measure(self, count: int) -> None:
        """Measure some more frames."""
        with opencv_threads(self._threads):
            if not self.totals:
                self._warm_up()
            for _ in range(count):
                self.totals.append(self._estimate())
                for stage, seconds in self._estimator.stages.seconds.items():
                    self.stages.setdefault(stage, []).append(seconds)
        before, planned = self._planned
        now = _memory_mib("VmRSS")
        self.memory = Memory(_memory_mib("VmHWM"), planned - before, now - planned)

    def times(self) -> Times:
        """Return the times of whole frames."""
        return Times.of(self.totals)

    def stage_times(self, *stages: str) -> Times:
        """Return the times of some stages together."""
        return Times.of(np.sum([self.stages[stage] for stage in stages], axis=0).tolist())

    def close(self) -> None:
        """End the threads, and let go of the frames."""
        self._estimator.close()
        self._frames = []

    def _estimate(self) -> float:
        frame = self._frames[self._next]
        self._next = (self._next + 1) % len(self._frames)
        start = time.perf_counter()
        self._estimator.estimate(frame, self.map_size)
        return time.perf_counter() - start

    def _warm_up(self) -> None:
        _forget_peak()
        before = _memory_mib("VmRSS")
        self._estimate()
        self._planned = before, _memory_mib("VmRSS")
        for _ in range(_WARM_UP - 1):
            self._estimate()


def _memory_mib(name: str) -> float:
    """Return an entry of the process' memory; NaN elsewhere than on Linux."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return float("nan")
    found = [float(line.split()[1]) for line in lines if line.startswith(f"{name}:")]
    return found[0] * 1024 / _MIB if found else float("nan")


def _forget_peak() -> None:
    """Let the peak of the memory begin here: learning a bank needs more than using it."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


class SpeedBenchmark:
    """All measurements, as a list of short steps, and what came of them.

    Parameters
    ----------
    setting : Setting
    extent : Extent

    Raises
    ------
    InputError
        If the bank cannot be learned, or a frame is smaller than its window.
    """

    def __init__(self, setting: Setting, extent: Extent) -> None:
        self.setting, self.extent = setting, extent
        self._banks: dict[int, FilterBank] = {}
        self._rates: list[Rates] = []
        self._runs: dict[tuple[str, Any], VideoRun] = {}
        self._filter_s: list[float] = []
        self._place_s: list[float] = []
        self._denoise_s: dict[int, list[float]] = {}

    def steps(self) -> list[Work]:
        """Return the work, to be done in this order; `results` is of all of it."""
        setting, extent = self.setting, self.extent
        main = [partial(self._measure, ("main", None), extent.frames)] * _MAIN_TURNS
        sizes: list[Any] = [("size", size) for size in extent.sizes]
        levels: list[Any] = [("levels", count) for count in extent.levels]
        threads: list[Any] = [("threads", count) for count in extent.threads]
        slow: list[Work] = [self._measure_filters, self._measure_places] * extent.repeats
        if setting.temporal_frames:
            for count in extent.denoised:
                slow += [partial(self._measure_denoising, count)] * extent.repeats
        cuts: list[Any] = [("regularize", how) for how in _ways_to_regularise()]
        return [
            *(partial(self._learn, count) for count in sorted({setting.levels, *extent.levels})),
            self._measure_rates,
            *main,
            self._measure_rates,
            *(step for keys in (sizes, levels, threads, cuts) for step in self._in_turns(keys)),
            *slow,
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
        }

    # The work.

    def _learn(self, levels: int) -> None:
        config = LearnConfig(window_px=self.setting.window_px, rank=self.setting.rank)
        mask = Mask.named(MASK)
        self._banks[levels] = learn_bank(blur_stack(mask, levels), config, mask=mask)

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

    def _measure_filters(self) -> None:
        """Convolve the frame with a few of the thesis' filters, and sum their squares.

        OpenCV does that by Fourier transforms where filters are as large as these.
        """
        threads = self.setting.threads
        random = np.random.default_rng(0)
        frame = random.random(self.setting.size, dtype=np.float32)
        side = (_THESIS_PATCH_PX, _THESIS_PATCH_PX)
        kernel = random.standard_normal(side).astype(np.float32)
        sums = [np.zeros_like(frame) for _ in range(threads)]

        def convolve(thread: int) -> None:
            for _ in range(_FILTERS_TRIED):
                cv2.accumulateSquare(cv2.filter2D(frame, cv2.CV_32F, kernel), sums[thread])

        with opencv_threads(1):  # each of our threads has its own filters
            self._filter_s += _seconds_in_threads(convolve, threads, _TRIES)

    def _measure_places(self) -> None:
        """Find the energies of some places from a common basis as large as the thesis'."""
        threads = self.setting.threads
        bank, frame = _some_subspaces(self._banks[self.setting.levels].stack)

        def energies(thread: int) -> None:
            bank.energies(frame, NOISE)

        self._place_s += _seconds_in_threads(energies, threads, _TRIES)

    def _measure_denoising(self, count: int) -> None:
        stack = self._banks[self.setting.levels].stack
        frames = moving_frames(stack, self.setting.size, count)
        pictures = [np.rint(255 * frame).astype(np.uint8) for frame in frames]
        with opencv_threads(self.setting.threads):
            start = time.perf_counter()
            cv2.fastNlMeansDenoisingMulti(pictures, count // 2, count)
            self._denoise_s.setdefault(count, []).append(time.perf_counter() - start)

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
            "frames_per_second": len(run.totals) / sum(run.totals),
            "memory": dataclasses.asdict(run.memory) if run.memory else None,
            "per_pixel": work.per_pixel(),
            "roofline": {
                "engine": dataclasses.asdict(
                    roofline(work.flop, engine_bytes, machine, engine.p50_ms)
                ),
                "frame": dataclasses.asdict(roofline(work.flop, all_bytes, machine, total.p50_ms)),
            },
        }

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
                    "speedup": first.over(run.times()),
                    "speedup_engine": first_engine.over(run.stage_times(*ENGINE_STAGES)),
                }
                for count, run in zip(self.extent.threads, runs, strict=True)
            ]
        }

    def _comparison(self) -> dict[str, Any]:
        run = self._runs["main", None]
        return {
            "thesis": self._thesis_results(run),
            "denoising": self._denoising_results(run) if self.setting.temporal_frames else None,
            "graph_cut": self._graph_cut_results(),
        }

    def _thesis_results(self, run: VideoRun) -> dict[str, Any]:
        setting, engine = self.setting, run.stage_times(*ENGINE_STAGES)
        filters = setting.levels * _THESIS_FILTERS
        tried = _FILTERS_TRIED * setting.threads
        pixels = setting.size[0] * setting.size[1]
        places = _PLACES[0] * _PLACES[1] * setting.threads
        grid = PatchGrid.covering(setting.size, setting.window_px, setting.stride_px)
        density = pixels / (grid.rows * grid.columns)
        unfactored = Times.of(self._filter_s, filters / tried)
        basis_s = np.multiply(self._filter_s, _THESIS_BASIS / tried)
        levels_s = np.multiply(self._place_s, pixels / places)
        factored = Times.of((basis_s + levels_s).tolist())

        def against(times: Times) -> dict[str, Any]:
            ratio = times.over(engine)
            per_place = {name: value / density for name, value in ratio.items()}
            return {"ratio": ratio, "ratio_per_place": per_place}

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
                    f"from {tried} filters on the whole frame to {_THESIS_BASIS}, and from the "
                    f"energies of {places} pixels to {pixels}"
                ),
                "filters": _THESIS_BASIS,
                "filters_p50_ms": 1000 * float(np.median(basis_s)),
                "energies_p50_ms": 1000 * float(np.median(levels_s)),
                "times": dataclasses.asdict(factored),
                **against(factored),
            },
        }

    def _denoising_results(self, run: VideoRun) -> dict[str, Any]:
        own = run.stage_times(*TEMPORAL_STAGES)
        rows = []
        for count, seconds in self._denoise_s.items():
            times = Times.of(seconds)
            rows.append(
                {"frames": count, "times": dataclasses.asdict(times), "ratio": times.over(own)}
            )
        return {"still_and_temporal": dataclasses.asdict(own), "non_local_means": rows}

    def _graph_cut_results(self) -> dict[str, Any] | None:
        times = {
            how: self._runs["regularize", how].stage_times("regularise")
            for how in _ways_to_regularise()
        }
        if "graphcut" not in times:
            return None
        return {
            "semiglobal": dataclasses.asdict(times["semiglobal"]),
            "graphcut": dataclasses.asdict(times["graphcut"]),
            "ratio": times["graphcut"].over(times["semiglobal"]),
        }


def _ways_to_regularise() -> tuple[str, ...]:
    """Return what is compared: graph cuts only where they are installed."""
    return ("semiglobal", "graphcut") if find_spec("maxflow") else ("semiglobal",)


def _some_subspaces(stack: PsfStack) -> tuple[SubspaceBank, SubspaceFrame]:
    """Return a bank of the thesis' size and projections: what the numbers are takes no time."""
    random = np.random.default_rng(0)
    size = (_THESIS_BASIS, _THESIS_BASIS)
    form = random.standard_normal(size).astype(np.float32)
    bank = SubspaceBank(
        stack=stack,
        patch_px=_THESIS_PATCH_PX,
        rank=_THESIS_FILTERS,
        basis=np.zeros((_THESIS_PATCH_PX**2, _THESIS_BASIS), np.float32),
        forms=np.broadcast_to(form, (len(stack), *size)),
        truncation_error=0.0,
        noise=0.0,
        mask_digest="",
        learned_from="nothing",
    )
    shape = tuple(side + _THESIS_PATCH_PX for side in _PLACES)
    projections = random.standard_normal((*_PLACES, _THESIS_BASIS)).astype(np.float32)
    return bank, SubspaceFrame(projections, PatchGrid.covering(shape, _THESIS_PATCH_PX, 1))


def thread_counts(most: int) -> tuple[int, ...]:
    """Return 1, 2, 4 and so on, and the most."""
    return tuple(sorted({most, *(2**power for power in range(most.bit_length()))}))
