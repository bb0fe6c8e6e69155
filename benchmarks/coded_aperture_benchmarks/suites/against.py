"""Time of a frame beside what else would give a depth map: stereo, and a monocular network."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

import cv2
import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.methods.monocular import INPUT_PX, Monocular, unsupported_reason
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.speed.frames import moving_frames
from coded_aperture_benchmarks.speed.grid import BLUR_PX
from coded_aperture_benchmarks.speed.machine import machine_rates, opencv_threads
from coded_aperture_benchmarks.speed.setting import MASK, Size
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

# Disparities that stereo matching tries, its block and the shift of the second picture, px.
_DISPARITIES = 64
_BLOCK_PX = 5
_SHIFT_PX = 20
# Memory of a video, frames; see `temporal_frames`.
_MEMORY = 4.0
_WARM_UP = 2

Way = Callable[[int], object]
# What a way is given.
_OWN = "one coded frame"
_PAIR = "two sharp frames of two cameras"
_SHARP = "one sharp frame; no metres"


@dataclasses.dataclass(frozen=True)
class Cell:
    """All ways, which take turns frame by frame."""

    size: Size
    threads: int
    frames: int


def _cells(args: options.Args) -> list[Cell]:
    return [Cell(args.size, args.threads, args.frames)]


def measure(cell: Cell) -> Row:
    """Measure all ways in turn: other work on the machine then disturbs all of them alike."""
    threads = thread_count(cell.threads)
    mask = Mask.named(MASK)
    stack = render_psf_stack(mask, np.linspace(*BLUR_PX))
    bank = learn_bank(stack, mask=mask)
    took: dict[str, list[tuple[float, float]]] = {}
    network = None if unsupported_reason() else Monocular(threads)
    with opencv_threads(threads), ExitStack() as until_measured:
        given = {
            _OWN: _own(bank, cell.size, threads, until_measured),
            _PAIR: _stereo(stack, cell.size),
            _SHARP: {} if network is None else _monocular(network, stack, cell.size),
        }
        ways = {name: way for of_kind in given.values() for name, way in of_kind.items()}
        for number in range(_WARM_UP + cell.frames):
            for name, way in ways.items():
                wall_s, processor_s = time.perf_counter(), time.process_time()
                way(number)
                took.setdefault(name, []).append(
                    (time.perf_counter() - wall_s, time.process_time() - processor_s)
                )
    rows = [
        {"way": name, "given": what, **_times(took[name][_WARM_UP:])}
        for what, of_kind in given.items()
        for name in of_kind
    ]
    found = {"threads": threads, "gflop_s": machine_rates(threads).gemm_gflop_s, "rows": rows}
    if network is not None:
        found["network"] = {
            "parameters": network.model.parameters,
            "multiply_adds": network.model.multiply_adds,
        }
    return found


def _times(seconds: Sequence[tuple[float, float]]) -> Row:
    wall_ms, processor_ms = 1000 * np.median(seconds, axis=0)
    p90_ms = 1000 * float(np.percentile([wall_s for wall_s, _ in seconds], 90))
    return {"ms": float(wall_ms), "p90_ms": p90_ms, "processor_ms": float(processor_ms)}


def _own(
    bank: FilterBank, size: Size, threads: int, until_measured: ExitStack
) -> Mapping[str, Way]:
    """Ways to depth from one coded frame, with the defaults of nodes and a map of its size."""
    frames = moving_frames(bank.stack, size)
    frames = [*frames, *frames[-2:0:-1]]  # no jump at the end
    ways: dict[str, Way] = {}
    for regularize, memory, name in (
        ("learned", 0.0, "refined, single frames"),
        ("learned", _MEMORY, "refined, video"),
        ("semiglobal", 0.0, "semiglobal, single frames"),
        ("semiglobal", _MEMORY, "semiglobal, video"),
    ):
        config = DepthConfig(regularize=regularize, temporal_frames=memory, threads=threads)
        estimator = DepthEstimator(bank, config)
        until_measured.callback(estimator.close)
        ways[name] = partial(_estimate, estimator, frames)
    return ways


def _estimate(estimator: DepthEstimator, frames: Sequence[FloatArray], number: int) -> None:
    estimator.estimate(frames[number % len(frames)])


def _stereo(stack: PsfStack, size: Size) -> Mapping[str, Way]:
    """OpenCV's stereo matching of two rectified 8-bit pictures."""
    left = np.uint8(255 * moving_frames(stack, size, count=1)[0])
    pair = left, np.roll(left, -_SHIFT_PX, axis=1)
    smoothness = {"P1": 8 * _BLOCK_PX**2, "P2": 32 * _BLOCK_PX**2}
    matchers: dict[str, Any] = {
        name: cv2.StereoSGBM_create(0, _DISPARITIES, _BLOCK_PX, mode=mode, **smoothness)
        for name, mode in (
            ("StereoSGBM, full (HH)", cv2.STEREO_SGBM_MODE_HH),
            ("StereoSGBM, one pass", cv2.STEREO_SGBM_MODE_SGBM),
            ("StereoSGBM, three ways", cv2.STEREO_SGBM_MODE_SGBM_3WAY),
        )
    }
    matchers["StereoBM"] = cv2.StereoBM_create(_DISPARITIES, 4 * _BLOCK_PX + 1)
    return {name: partial(_match, matcher, pair) for name, matcher in matchers.items()}


def _match(matcher: Any, pair: tuple[Any, Any], _: int) -> None:
    matcher.compute(*pair)


def _monocular(network: Monocular, stack: PsfStack, size: Size) -> Mapping[str, Way]:
    """Network of the size of MiDaS small, on a colour picture."""
    grey = (255 * moving_frames(stack, size, count=1)[0]).astype(np.uint8)
    picture = np.repeat(grey[..., None], 3, axis=2)
    return {f"network as MiDaS small, {INPUT_PX} px": lambda _: network(picture)}


def _text(results: Row) -> str:
    found = results["cells"][0]
    described: dict[str, Any] = {
        "": "{way}",
        "given": "{given}",
        "time, ms": "{ms:.1f}",
        "90 %": "{p90_ms:.1f}",
        "processor time, ms": "{processor_ms:.1f}",
    }
    network = found.get("network")
    about = (
        f"network: {network['parameters'] / 1e6:.1f} million parameters, random, "
        f"{network['multiply_adds'] / 1e9:.2f} billion multiply-adds"
        if network
        else unsupported_reason()
    )
    return (
        f"medians; {found['threads']} thread(s), {found['gflop_s']:.0f} GFLOP/s in float32 matrix "
        f"products; stereo with {_DISPARITIES} disparities\n{about}\n"
        f"{columns(found['rows'], described)}"
    )


SUITE = Suite(
    name="against",
    description="Time of a frame, and how much of the processors' time it takes, beside OpenCV's "
    "stereo matching of two pictures of the same size, and a monocular network of the size of "
    "MiDaS small (with random weights; needs onnx and onnxruntime); all take turns in one run. It "
    "says nothing about accuracy.",
    examples="""examples:
  frames of 640x480:
    python -m coded_aperture_benchmarks against
""",
    options=(
        options.frame_size(480, 640),
        options.THREADS,
        options.number("--frames", 1, 40, "frames of each"),
        options.JSON,
        options.OUTPUT,
    ),
    said=("size",),
    cells=_cells,
    measure=measure,
    text=_text,
)
