"""The blend of deblurring: which hypotheses a picture is made of; see `deblur/blend`."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pictures import DEPTHS, PICTURES
from shards import Arrays
from states import check_enough
from task import Options, Task
from torch import nn
from torch.nn import functional

from coded_aperture_ros.calibration.fine_tuning.loop import (
    Problem,
    Schedule,
    device_of,
    on_device,
    shuffled,
    turned,
)
from coded_aperture_ros.calibration.fine_tuning.onnx_form import fold, round_weights, to_onnx
from coded_aperture_ros.deblur.blend import blend as package
from coded_aperture_ros.deblur.blend.features import CELL_PX, MAPS
from coded_aperture_ros.deblur.blend.hypotheses import HYPOTHESES

PIXELS = CELL_PX**2
BATCH = 16
_RATE = 2e-3
# Channels of cells, and of squares of two by two cells, which see farther; and layers of these.
_FINE = 32
_COARSE = 64
_COARSE_LAYERS = 4
# The hypothesis that a pixel begins with: its own blur size, well bounded.
_SAFE = 1
# Cells a side of what is learned from at a time: a part of each frame.
_PART = 32
# What is not worth removing, as a share of the error of the blurred frame.
_ENOUGH = 0.02
# Errors in units of local contrast count too: plain areas must stay plain.
_LOCAL_SHARE = 0.5
# Of a frame that is sharp already: squared error, and mean error in units of local contrast.
_LEAST_POWER = 1e-4
_LEAST_LOCAL = 0.02
_DB = 10 / math.log(10)
# Cells of what is written into the file; OpenCV takes other sizes, too.
_ROWS = 120
_COLUMNS = 160


def _layer(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Convolution with batch normalisation, which is folded into it in the end."""
    convolution = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs))


class Blend(nn.Module):
    """Hypotheses and maps in cells to weights of the hypotheses, and what is added to them.

    Takes the cells and maps of `pictures.picture_arrays`, one after the other [batch, channels,
    rows, columns], rows and columns even. Returns for each pixel of a cell the weights of all
    hypotheses, and last what is added [batch, (hypotheses + 1) * 16, rows, columns].
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(HYPOTHESES * PIXELS + MAPS, _FINE, 1)
        self.fine = _layer(_FINE, _FINE)
        self.down = _layer(_FINE, _COARSE, 2)
        self.coarse = nn.ModuleList(_layer(_COARSE, _COARSE) for _ in range(_COARSE_LAYERS))
        self.up = nn.Conv2d(_COARSE, _FINE, 1)
        self.both = _layer(_FINE, _FINE)
        self.last = nn.Conv2d(_FINE, (HYPOTHESES + 1) * PIXELS, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        with torch.no_grad():
            self.last.bias[_SAFE * PIXELS : (_SAFE + 1) * PIXELS] = 1

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        fine = torch.relu(self.first(shown))
        fine = torch.relu(fine + self.fine(fine))
        coarse = torch.relu(self.down(fine))
        for layer in self.coarse:
            coarse = torch.relu(coarse + layer(coarse))
        found = torch.relu(fine + functional.interpolate(self.up(coarse), scale_factor=2))
        return self.last(torch.relu(found + self.both(found)))


class _Folded(nn.Module):
    """The network without batch normalisation, and with fewer additions."""

    def __init__(self, network: Blend) -> None:
        super().__init__()
        fold(network)
        self.first, self.up, self.last = network.first, network.up, network.last
        self.fine, self.both = _with_input(network.fine), _with_input(network.both)
        self.down = network.down[0]
        self.coarse = nn.ModuleList(_with_input(layer) for layer in network.coarse)

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        fine = torch.relu(self.fine(torch.relu(self.first(shown))))
        coarse = torch.relu(self.down(fine))
        for layer in self.coarse:
            coarse = torch.relu(layer(coarse))
        up = functional.interpolate(self.up(coarse), scale_factor=2)
        return self.last(torch.relu(self.both(torch.relu(fine + up))))


def _with_input(layer: nn.Sequential) -> nn.Conv2d:
    """Convolution that gives the folded layer's input and output together."""
    convolution: nn.Conv2d = layer[0]
    middle = range(convolution.out_channels)
    convolution.weight.data[middle, middle, 1, 1] += 1
    return convolution


def blended(outputs: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
    """Picture in cells [batch, 16, rows, columns], from outputs of `Blend` and the hypotheses.

    Weights are made to sum to 1.
    """
    outputs = outputs.unflatten(1, (HYPOTHESES + 1, PIXELS))
    weights, added = outputs[:, :-1], outputs[:, -1]
    weights = weights + (1 - weights.sum(1, keepdim=True)) / HYPOTHESES
    return (weights * cells.unflatten(1, (HYPOTHESES, PIXELS))).sum(1) + added


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """One frame with one blur map as it is kept in memory; see `pictures.picture_arrays`.

    Attributes
    ----------
    cells : ndarray, float16 [hypotheses * 16, rows, columns]
    maps : ndarray, float16 [MAPS, rows, columns]
    sharp : ndarray, float16 [16, rows, columns]
        The truth.
    scale : ndarray, float32 [rows, columns]
        What all of them were divided by.
    """

    cells: np.ndarray
    maps: np.ndarray
    sharp: np.ndarray
    scale: np.ndarray

    def part(self, top: int, left: int) -> "Picture":
        """`_PART` cells a side from a cell on."""
        at = np.s_[..., top : top + _PART, left : left + _PART]
        return Picture(self.cells[at], self.maps[at], self.sharp[at], self.scale[at])

    def turned(self, flip: bool, turns: int) -> "Picture":
        """Mirrored and turned by right angles: the cells, and the pixels in each of them."""
        return Picture(
            turned(self.cells, flip, turns, CELL_PX),
            turned(self.maps, flip, turns),
            turned(self.sharp, flip, turns, CELL_PX),
            turned(self.scale, flip, turns),
        )

    def negative(self) -> "Picture":
        """Dark as bright, around the local mean."""
        return dataclasses.replace(self, cells=-self.cells, sharp=-self.sharp)


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Pictures as tensors, float32 [batch, ...]."""

    cells: torch.Tensor
    maps: torch.Tensor
    sharp: torch.Tensor
    scale: torch.Tensor


def batch_of(pictures: list[Picture]) -> Batch:
    """Pictures stacked, in the order of channels that is fastest."""
    arrays = zip(*(vars(picture).values() for picture in pictures), strict=True)
    tensors = [torch.from_numpy(np.stack(values).astype(np.float32)) for values in arrays]
    channels_last = torch.channels_last
    return Batch(*(t.contiguous(memory_format=channels_last) for t in tensors[:3]), tensors[3])


def load_pictures(folder: Path, shards: tuple[int, ...]) -> list[Picture]:
    """Pictures of the shards that are there: `DEPTHS` of each frame, one after the other."""
    pictures = []
    for shard in shards:
        if PICTURES.exists(folder, shard):
            stored = PICTURES.read(folder, shard)
            arrays = [stored[field.name] for field in dataclasses.fields(Picture)]
            flat = (values.reshape(-1, *values.shape[2:]) for values in arrays)
            pictures += [Picture(*values) for values in zip(*flat, strict=True)]
    return pictures


def batches(pictures: list[Picture], seed: int) -> Iterator[Batch]:
    """Batches of parts of all pictures in random order, turned at random, without an end."""
    random = np.random.default_rng(seed)
    for some in shuffled(pictures, BATCH, random):
        yield batch_of([_augmented(picture, random) for picture in some])


def _augmented(picture: Picture, random: np.random.Generator) -> Picture:
    top, left = random.integers(0, picture.scale.shape[0] - _PART + 1, 2)
    picture = picture.part(top, left).turned(bool(random.integers(2)), int(random.integers(4)))
    return picture.negative() if random.random() < 0.5 else picture


def _errors(network: nn.Module, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
    """Errors of the blended pictures beside those of the blurred frames; each [batch].

    Ratio of the squared errors in linear light, and of the mean errors in units of local contrast.
    """
    found = blended(network(torch.cat([batch.cells, batch.maps], 1)), batch.cells)
    # In linear light, but no picture counts more because it has more contrast.
    scale = batch.scale / batch.scale.mean((1, 2), keepdim=True)
    wrong, blurred = found - batch.sharp, batch.cells[:, -PIXELS:] - batch.sharp
    (power, local), (power_0, local_0) = (
        ((error * scale[:, None]).pow(2).mean((1, 2, 3)), error.abs().mean((1, 2, 3)))
        for error in (wrong, blurred)
    )
    return power / (power_0 + _LEAST_POWER), local / (local_0 + _LEAST_LOCAL)


def _loss(network: nn.Module, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """What is minimised; and what is printed: the gain in dB, and local errors."""
    power, local = _errors(network, batch)
    log_power, mean_local = (power + _ENOUGH).log().mean(), local.mean()
    parts = {"gain_db": -_DB * log_power, "local": mean_local}
    return log_power + _LOCAL_SHARE * mean_local, parts


def _score(network: nn.Module, held_back: list[Picture]) -> dict[str, float]:
    """Mean gains in dB of whole pictures that are not learned from, and of the worst tenth.

    One each for estimated depth, and for true depth that was made worse.
    """
    with torch.no_grad():
        batches = (on_device(batch_of([picture]), device_of(network)) for picture in held_back)
        each = [_errors(network, batch)[0] for batch in batches]
    gains = -_DB * torch.cat(each).log().reshape(-1, DEPTHS)
    found = {}
    for name, of_depth in zip(("estimated", "worsened"), gains.unbind(1), strict=True):
        worst = of_depth.sort().values[: math.ceil(len(of_depth) / 10)]
        found |= {name: float(of_depth.mean()), f"{name}_worst": float(worst.mean())}
    return {name: round(value, 3) for name, value in found.items()}


class BlendTask(Task):
    """Fit what makes pictures of hypotheses."""

    module = package
    # What goes in is exact as it is, and what comes out is the picture.
    exact = ("/first/", "/last/")

    def problem(self, options: Options) -> Problem:
        pictures = load_pictures(options.folder, options.shards)
        held_back = load_pictures(options.folder, options.held_back)
        check_enough(pictures, held_back, BATCH, DEPTHS)
        schedule = Schedule(
            options.minutes, options.rate or _RATE, warm_steps=200, decay=1e-3, largest_gradient=1.0
        )
        return Problem(
            Blend(),
            schedule,
            lambda seed: batches(pictures, seed),
            _loss,
            lambda average: _score(average, held_back),
        )

    def arrays(self, weights: dict[str, torch.Tensor], options: Options) -> dict[str, Any]:
        network = Blend()
        network.load_state_dict(weights)
        folded = _Folded(network)
        round_weights(folded)
        shown = torch.zeros(1, HYPOTHESES * PIXELS + MAPS, _ROWS, _COLUMNS)
        return {"blend_onnx": to_onnx(folded, {"shown": shown}, "told")}

    def quantisation_inputs(self, options: Options) -> dict[str, list[Arrays]]:
        # One of the two depths by which each frame is deblurred.
        pictures = load_pictures(options.folder, options.shards[:1])[::DEPTHS]
        shown = (np.concatenate([one.cells, one.maps])[None] for one in pictures)
        return {"blend": [{"shown": values.astype(np.float32)} for values in shown]}
