"""Fit the network that blends hypotheses of deblurring; goes on where it was stopped.

python training/blend_fit.py --pictures DIR --output DIR --minutes 45
"""

import argparse
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from blend_network import PIXELS, Blend, blended
from fit import Fit, Schedule, add_fit_options, check_enough
from pictures import DEPTHS
from shards import shards_of

from coded_aperture_ros.deblur.blend.features import CELL_PX

_BATCH = 16
# Cells a side of what is learned from at a time: a part of each frame.
_PART = 32
# What is not worth removing, as a share of the error of the blurred frame.
_ENOUGH = 0.02
# Errors in units of local contrast count too: plain areas must stay plain.
_OF_LOCAL = 0.5
# Of a frame that is sharp already: squared error, and mean error in units of local contrast.
_LEAST_POWER, _LEAST_LOCAL = 1e-4, 0.02
_DB = 10 / math.log(10)


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """One frame with one blur map as it is kept in memory; see `pictures.list_pictures`.

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
        """Return `_PART` cells a side from a cell on."""
        at = np.s_[..., top : top + _PART, left : left + _PART]
        return Picture(self.cells[at], self.maps[at], self.sharp[at], self.scale[at])

    def turned(self, flip: bool, turns: int) -> "Picture":
        """Mirror and turn by right angles: the cells, and the pixels in each of them."""

        def turn(values: np.ndarray) -> np.ndarray:
            values = values[..., ::-1] if flip else values
            return np.ascontiguousarray(np.rot90(values, turns, axes=(-2, -1)))

        order = turn(np.arange(PIXELS).reshape(CELL_PX, CELL_PX)).ravel()
        cells, sharp = turn(self.cells), turn(self.sharp)
        of_hypotheses = cells.reshape(-1, PIXELS, *cells.shape[1:])
        cells = of_hypotheses[:, order].reshape(cells.shape)
        return Picture(cells, turn(self.maps), sharp[order], turn(self.scale))

    def negative(self) -> "Picture":
        """Return dark as bright, around the local mean."""
        return dataclasses.replace(self, cells=-self.cells, sharp=-self.sharp)


@dataclasses.dataclass(frozen=True, eq=False)
class PictureBatch:
    """Tensors of some pictures, float32; see `Picture`."""

    cells: torch.Tensor
    maps: torch.Tensor
    sharp: torch.Tensor
    scale: torch.Tensor

    @classmethod
    def of(cls, pictures: list[Picture]) -> "PictureBatch":
        """Stack some pictures; in the order of channels that is fastest."""
        found = []
        for field in dataclasses.fields(Picture):
            values = np.stack([getattr(picture, field.name) for picture in pictures])
            tensor = torch.from_numpy(values.astype(np.float32))
            if tensor.dim() == 4:
                tensor = tensor.contiguous(memory_format=torch.channels_last)
            found.append(tensor)
        return cls(*found)


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """What a network got wrong, beside what is wrong with the blurred frame; each [batch].

    Attributes
    ----------
    power : Tensor
        Ratio of the squared errors, in linear light.
    local : Tensor
        Ratio of the mean errors, in units of local contrast.
    """

    power: torch.Tensor
    local: torch.Tensor

    @classmethod
    def of(cls, network: Blend, batch: PictureBatch) -> "Errors":
        """Blend the pictures of a batch, and compare."""
        found = blended(network(torch.cat([batch.cells, batch.maps], 1)), batch.cells)
        # In linear light, but no picture counts more because it has more contrast.
        scale = batch.scale / batch.scale.mean((1, 2), keepdim=True)
        wrong, blurred = found - batch.sharp, batch.cells[:, -PIXELS:] - batch.sharp
        (power, local), (power_0, local_0) = (
            ((error * scale[:, None]).pow(2).mean((1, 2, 3)), error.abs().mean((1, 2, 3)))
            for error in (wrong, blurred)
        )
        return cls(power / (power_0 + _LEAST_POWER), local / (local_0 + _LEAST_LOCAL))

    def loss(self) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Return what is minimised; and what is printed: the gain in dB, and local errors."""
        log_power, local = (self.power + _ENOUGH).log().mean(), self.local.mean()
        return log_power + _OF_LOCAL * local, {"gain_db": -_DB * log_power, "local": local}


def load(folder: Path, shards: range) -> list[Picture]:
    """Read the shards that are there; each frame gives `DEPTHS` pictures, one after the other."""
    pictures = []
    for shard in shards:
        path = folder / f"pictures_{shard:04d}.npz"
        if not path.exists():
            continue
        with np.load(path) as stored:
            arrays = [stored[field.name] for field in dataclasses.fields(Picture)]
        flat = (values.reshape(-1, *values.shape[2:]) for values in arrays)
        pictures += [Picture(*values) for values in zip(*flat, strict=True)]
    return pictures


def batches(pictures: list[Picture], size: int, seed: int) -> Iterator[PictureBatch]:
    """Yield batches of parts of all pictures in random order, turned at random, for ever."""
    random = np.random.default_rng(seed)
    while True:
        order = random.permutation(len(pictures))
        for start in range(0, len(order) - size + 1, size):
            yield PictureBatch.of(
                [_augmented(pictures[i], random) for i in order[start : start + size]]
            )


def _augmented(picture: Picture, random: np.random.Generator) -> Picture:
    top, left = random.integers(0, picture.scale.shape[0] - _PART + 1, 2)
    picture = picture.part(top, left).turned(bool(random.integers(2)), int(random.integers(4)))
    return picture.negative() if random.random() < 0.5 else picture


def validated(network: Blend, held: list[Picture]) -> dict[str, float]:
    """Return mean gains in dB of whole pictures that are not learned from, and of the worst tenth.

    One each for estimated depth, and for true depth that was made worse.
    """
    network.eval()
    with torch.no_grad():
        each = [Errors.of(network, PictureBatch.of([picture])).power for picture in held]
    gains = -_DB * torch.cat(each).log().reshape(-1, DEPTHS)
    found = {}
    for name, of_depth in zip(("estimated", "worsened"), gains.unbind(1), strict=True):
        worst = of_depth.sort().values[: math.ceil(len(of_depth) / 10)]
        found |= {name: float(of_depth.mean()), f"{name}_worst": float(worst.mean())}
    return {name: round(value, 3) for name, value in found.items()}


def main() -> None:
    """Fit, and keep what was reached every few minutes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path, required=True)
    add_fit_options(parser, minutes=45.0, held=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    pictures = load(args.pictures, shards_of(args.shards))
    held = load(args.pictures, shards_of(args.validate))
    check_enough(pictures, held, _BATCH, DEPTHS, "pictures")
    how = Schedule(args.minutes, args.rate, warm_steps=200, decay=1e-3, largest_gradient=1.0)
    fit = Fit(Blend(), how, args.output, args.start)
    fit.run(
        batches(pictures, _BATCH, fit.step + 1),
        lambda batch: Errors.of(fit.network, batch).loss(),
        lambda: validated(fit.average, held),
    )


if __name__ == "__main__":
    main()
