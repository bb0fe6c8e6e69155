"""Depth on a GPU: whether it is the same as on the processor, and how long each stage takes."""

import argparse
import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from importlib import import_module
from typing import Any

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.speed.frames import moving_frames
from coded_aperture_benchmarks.speed.grid import BLUR_PX
from coded_aperture_benchmarks.speed.setting import MASK, Size
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.text_table import columns, table
from coded_aperture_ros.deblur import AnyDeblurrer, DeblurConfig, make_deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.likelihood import check_backend
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank
from coded_aperture_ros.metrics.times import Times
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

_BACKENDS = {"cuda": "cuda", "cpu": "torch"}
# Memory of a video, frames; see `temporal_frames`.
_MEMORY = 4.0
_WARM_UP = 5
# Blur of the camera at infinity, px.
_INFINITY_PX = 19.2
# Frames on the processor, for one on the device; they are only for comparison.
_PROCESSOR_SHARE = 5
_SEEDS = 3
_NOISE = 0.002
# Light of the channels.
_SHARES = (0.9, 0.7, 0.8)
# Difference of levels that counts as none, levels.
_SAME = 0.02
# Channels, memory, and options of the stages that are only there when they are asked for.
_KINDS: dict[str, tuple[int, float, dict[str, Any]]] = {
    "still, grey": (1, 0.0, {}),
    "still, colour": (3, 0.0, {}),
    "video, grey": (1, _MEMORY, {}),
    "video, colour": (3, _MEMORY, {}),
    "still, all layers": (
        1,
        0.0,
        {"free_space_risk": 0.005, "second_surface": True, "unknown": "nearest"},
    ),
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """Frames of a size: their depth is compared, or timed, or they are deblurred."""

    what: str
    device: str
    size: Size
    frames: int
    kind: str = ""


def _cells(args: options.Args) -> list[Cell]:
    try:
        check_backend(_BACKENDS[args.device])
    except InputError as error:
        reason = str(error).removeprefix("backend: ").partition(": use torch")[0]
        raise InputError(f"--device {args.device}: {reason}: use --device cpu") from error
    cells = []
    for size in args.sizes:
        cells += [Cell("agreement", args.device, size, _SEEDS, kind) for kind in _KINDS]
        cells += [Cell("depth", args.device, size, args.frames, kind) for kind in _KINDS]
        cells.append(Cell("deblurring", args.device, size, args.frames))
    return cells


def measure(cell: Cell) -> Row:
    """Measure one cell, after warm-up: a GPU compiles, chooses and records in the first frames."""
    bank = _bank()
    measured = {"agreement": _agreement, "depth": _depth_times, "deblurring": _deblurring_times}
    about = {"what": cell.what, "size": "{1}x{0}".format(*cell.size), "kind": cell.kind}
    return {**about, **measured[cell.what](cell, bank)}


def _bank() -> FilterBank:
    mask = Mask.named(MASK)
    return learn_bank(render_psf_stack(mask, np.linspace(*BLUR_PX)), mask=mask)


def _estimators(cell: Cell, bank: FilterBank) -> tuple[DepthEstimator, DepthEstimator]:
    """Estimators on the device, and on the processor with the network in float32."""
    _, memory, asked = _KINDS[cell.kind]
    backend = _BACKENDS[cell.device]
    # PyTorch's threads wait actively, which takes the processor from others.
    threads = 1 if cell.device == "cpu" else 0
    on_device = DepthConfig(temporal_frames=memory, backend=backend, threads=threads, **asked)
    usual = DepthConfig(temporal_frames=memory, network="opencv", **asked)
    rows, columns = cell.size
    # Whose blur at infinity is a little more than the bank's largest.
    extent_mm = 1000 * _INFINITY_PX / columns
    camera = Camera(float(columns), 1.0, columns, rows, Mask.named(MASK), extent_mm)
    return DepthEstimator(bank, on_device, camera), DepthEstimator(bank, usual, camera)


def _agreement(cell: Cell, bank: FilterBank) -> Row:
    """Share of pixels with equal levels, on rendered scenes with missing and saturated pixels."""
    channels, memory, asked = _KINDS[cell.kind]
    on_device, usual = _estimators(cell, bank)
    rows: list[dict[str, float]] = []
    for seed in range(cell.frames):
        light = _scene(seed, cell.size)
        frame = np.ascontiguousarray(light if channels == 3 else light[..., 0])
        for _ in range(2 if memory else 1):
            found, expected = on_device.estimate(frame), usual.estimate(frame)
        rows.append(_differences(found, expected))
    on_device.close()
    usual.close()
    shares = ("equal", "layers") if asked else ("equal",)
    worst = {name: min(row[name] for row in rows) for name in shares}
    return worst | {name: max(row[name] for row in rows) for name in ("confidence", "health")}


@lru_cache(maxsize=_SEEDS)
def _scene(seed: int, size: Size) -> FloatArray:
    """Light of a rendered scene with missing and saturated pixels, float32 [rows, columns, 3]."""
    coded = random_scene(seed, Mask.named(MASK), "far", size).coded()
    noise = np.random.default_rng(seed).standard_normal((3, *coded.shape), np.float32)
    channels = zip(_SHARES, noise, strict=True)
    light = np.stack([share * coded + _NOISE * each for share, each in channels], axis=-1)
    light[: size[0] // 8, : size[1] // 8] = np.nan
    light[-size[0] // 8 :, -size[1] // 8 :] = 1
    return light


def _differences(found: DepthEstimate, expected: DepthEstimate) -> dict[str, float]:
    """Shares of equal levels and layers, and differences of confidence and health.

    What is unknown in both is equal.
    """
    layers = [
        np.isclose(found.layers[name].values, layer.values, rtol=0.01, equal_nan=True).mean()
        for name, layer in expected.layers.items()
    ]
    health, other = (
        0.0 if each is None else each.value for each in (found.health, expected.health)
    )
    return {
        "equal": float(
            np.isclose(found.level, expected.level, rtol=0, atol=_SAME, equal_nan=True).mean()
        ),
        "layers": float(min(layers, default=1.0)),
        "confidence": float(np.abs(found.confidence - expected.confidence).max()),
        "health": abs(health - other),
    }


def _depth_times(cell: Cell, bank: FilterBank) -> Row:
    """Times of whole frames, and of each stage, after which the device is waited for."""
    channels, *_ = _KINDS[cell.kind]
    frames = _frames(bank, cell.size, channels)
    on_device, usual = _estimators(cell, bank)
    wait = _waiting(cell.device)
    times = _frame_times(on_device.estimate, frames, cell.frames)
    stages: dict[str, list[float]] = {}
    for number in range(cell.frames):
        for stage, seconds in _stage_times(on_device, frames[number % len(frames)], wait):
            stages.setdefault(stage, []).append(seconds)
    few = max(cell.frames // _PROCESSOR_SHARE, 1)
    on_processor = _frame_times(usual.estimate, frames, few)
    recorded = _is_recorded(on_device, cell.size)
    on_device.close()
    usual.close()
    return {
        **dataclasses.asdict(times),
        "recorded": recorded,
        "processor_p50_ms": on_processor.p50_ms,
        "stages_ms": {name: 1000 * float(np.median(each)) for name, each in stages.items()},
    }


def _frames(bank: FilterBank, size: Size, channels: int) -> list[FloatArray]:
    """Frames of a scene that moves to and fro, without a jump."""
    videos = [moving_frames(bank.stack, size, seed=seed) for seed in range(channels)]
    frames = [
        np.ascontiguousarray(np.squeeze(np.dstack(each))) for each in zip(*videos, strict=True)
    ]
    return [*frames, *frames[-2:0:-1]]


def _frame_times(
    work: Callable[[FloatArray], object], frames: Sequence[FloatArray], count: int
) -> Times:
    """Times of whole frames, whose results lie in the processor's memory."""
    seconds = []
    for number in range(_WARM_UP + count):
        began_s = time.perf_counter()
        work(frames[number % len(frames)])
        seconds.append(time.perf_counter() - began_s)
    return Times.from_seconds(seconds[_WARM_UP:])


def _stage_times(
    estimator: DepthEstimator, frame: FloatArray, wait: Callable[[], None]
) -> list[tuple[str, float]]:
    """Names of the stages, and how long each took."""
    work = estimator.begin(frame)
    shape, found = work.frame.shape, []
    for stage in (*estimator.front(shape), *estimator.back(shape)):
        wait()
        began_s = time.perf_counter()
        stage(work)
        wait()
        found.append((stage.name, time.perf_counter() - began_s))
    return found


def _waiting(device: str) -> Callable[[], None]:
    """Function that waits until the device has done its work."""
    if device == "cpu":
        return lambda: None
    synchronize: Callable[[], None] = import_module("torch").cuda.synchronize
    return synchronize


def _is_recorded(estimator: DepthEstimator, size: Size) -> bool:
    """Whether the steps from costs to maps and of the check of fit are CUDA graphs."""
    stages: Sequence[Any] = estimator.back(size)
    decoders = [stage.decoder for stage in stages if hasattr(stage, "decoder")]
    checks = [stage.check.on_device for stage in stages if hasattr(stage, "check")]
    return all(getattr(part, "is_recorded", False) for part in (*decoders, *checks))


def _deblurring_times(cell: Cell, bank: FilterBank) -> Row:
    """Times of deblurring colour frames by `fast`, with a map of half their size."""
    stack = bank.stack
    rows, width = (-(-length // 2) for length in cell.size)
    # The simulated scene lies in four upright bands, each at a depth of its own.
    bands = np.arange(width) * 4 // width
    levels = np.linspace(0, len(stack) - 1, 4).round().astype(int)[bands]
    blur_map = np.tile(stack.blur_sizes_px[levels].astype(np.float32), (rows, 1))
    frames = _frames(bank, cell.size, 3)
    few = max(cell.frames // _PROCESSOR_SHARE, 1)
    found = {}
    for backend, count in ((_BACKENDS[cell.device], cell.frames), ("numpy", few)):
        deblurrer = make_deblurrer(bank, DeblurConfig(method="fast", backend=backend))
        found[backend] = _frame_times(partial(_deblurred, deblurrer, blur_map), frames, count)
        deblurrer.close()
    of_processor = found.pop("numpy")
    (times,) = found.values()
    return {
        **dataclasses.asdict(times),
        "kind": "still, colour",
        "processor_p50_ms": of_processor.p50_ms,
    }


def _deblurred(deblurrer: AnyDeblurrer, blur_map: FloatArray, frame: FloatArray) -> FloatArray:
    return deblurrer.deblur(frame, blur_map)


def _text(results: Row) -> str:
    rows = results["cells"]
    agreement, depth, deblurring = (
        [row for row in rows if row["what"] == what]
        for what in ("agreement", "depth", "deblurring")
    )
    return "\n\n".join(
        [
            f"device: {_device_name(results['device'])}",
            "as on the processor, rendered scenes, the worst\n"
            + columns(
                agreement,
                {
                    "size": "{size}",
                    "frames": "{kind}",
                    "levels equal": lambda row: f"{100 * row['equal']:.3f} %",
                    "confidence differs by": "{confidence:.4f}",
                    "health by": "{health:.4f}",
                    "layers equal": lambda row: (
                        f"{100 * row['layers']:.3f} %" if "layers" in row else ""
                    ),
                },
            ),
            "depth of a frame, ms\n" + columns(depth, _OF_DEPTH),
            "its stages, the device waited for after each, medians, ms\n" + _stage_table(depth),
            "deblurring by fast, ms\n" + columns(deblurring, _TIMES),
        ]
    )


_TIMES: Mapping[str, Any] = {
    "size": "{size}",
    "frames": "{kind}",
    "p50": "{p50_ms:.2f}",
    "p99": "{p99_ms:.2f}",
    "frames/s": lambda row: f"{1000 / row['p50_ms']:.0f}",
    "on the processor": "{processor_p50_ms:.1f}",
}
_OF_DEPTH: Mapping[str, Any] = {
    **_TIMES,
    "recorded": lambda row: "yes" if row["recorded"] else "no",
}


def _stage_table(rows: Sequence[Row]) -> str:
    names = list(dict.fromkeys(name for row in rows for name in row["stages_ms"]))
    header = ["size, frames", *names]
    lines = [
        [
            f"{row['size']} {row['kind']}",
            *(
                f"{row['stages_ms'][name]:.2f}" if name in row["stages_ms"] else ""
                for name in names
            ),
        ]
        for row in rows
    ]
    return table(header, lines)


def _device_name(device: str) -> str:
    torch = import_module("torch")
    name = torch.cuda.get_device_name() if device == "cuda" else "processor, by PyTorch"
    return f"{name}, PyTorch {torch.__version__}"


def _sizes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=options.size,
        default=[(480, 640), (720, 1280)],
        metavar="WxH",
        help="sizes of the frames, px (default 640x480 1280x720)",
    )


SUITE = Suite(
    name="gpu",
    description="Depth with the default refinement on a GPU, by PyTorch: whether levels are those "
    "of the processor, on rendered scenes, and how long frames and stages take, beside NumPy with "
    "OpenCV on the same computer; and deblurring by fast.",
    examples="""examples:
  on the GPU of this computer:
    python -m coded_aperture_benchmarks gpu
  whether the program runs, without a GPU:
    python -m coded_aperture_benchmarks gpu --device cpu --sizes 160x120 --frames 2
""",
    options=(
        options.option("--device", "of PyTorch", "cuda", choices=tuple(_BACKENDS)),
        _sizes,
        options.number("--frames", 1, 200, "frames that are timed, of each kind"),
        options.JSON,
        options.OUTPUT,
    ),
    said=("device",),
    cells=_cells,
    measure=measure,
    text=_text,
)
