"""The second surface in a window: nets, leaves and panes before something farther away."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from coded_aperture_benchmarks.metrics.surfaces import BINS
from states import check_enough
from task import Options, Task
from torch import nn
from torch.nn import functional
from weights_file import read_weights
from windows import WINDOWS

from coded_aperture_ros.calibration.fine_tuning.cells import CELLS
from coded_aperture_ros.calibration.fine_tuning.loop import (
    Problem,
    Schedule,
    device_of,
    shuffled,
    turned,
)
from coded_aperture_ros.calibration.fine_tuning.network import Around, convolution
from coded_aperture_ros.calibration.fine_tuning.onnx_form import (
    fold,
    load_folded,
    onnx_weights,
    renormalise,
    round_weights,
    to_onnx,
)
from coded_aperture_ros.depth.decoders.network import second as package
from coded_aperture_ros.depth.decoders.network.features import BLUR_STEP_PX

_BATCH = 16
# Cells a side of what is learned from at a time: a part of each frame.
_PART = 36
_RATE = 2e-3
_FURTHER_RATE = 6e-4
# Channels of cells and of squares of two by two cells, and the distances that these look at.
_CELL = 48
_SQUARE = 64
_DISTANCES = (1, 2, 1)
# Probabilities are small numbers beside the rest.
_LARGER = 4.0
# Whether there are two counts the most, then which, then their shares.
_TWO_FACTOR = 2.0
_SIZES_FACTOR = 0.5
_SHARE_FACTOR = 0.3
_FALSE_ALARMS = (0.02, 0.05)
# Of the windows with one surface, so many may pass for two.
_CALIBRATED_FALSE_ALARMS = 0.02
_RENORMALISED_BATCHES = 24
# Cells of what is written into the file; OpenCV takes other sizes, too.
_ROWS = 60
_COLUMNS = 80


class Second(nn.Module):
    """From cells of 8 px to squares of 16 px, and what is around them."""

    def __init__(self, shown: int) -> None:
        super().__init__()
        self.stem = convolution(shown, _CELL)
        self.down = convolution(_CELL, _SQUARE, 3, 2)
        self.around = nn.Sequential(*(Around(_SQUARE, far) for far in _DISTANCES))
        self.out = nn.Conv2d(_SQUARE, 4 * package.CHANNELS, 1)

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        """What is told of the four cells of each square, one after the other."""
        found: torch.Tensor = self.out(self.around(self.down(self.stem(shown))))
        return found


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """What the network is given of a frame, and what is true: see `windows`; float16."""

    shown: np.ndarray
    truth: np.ndarray  # [4, cells, cells]: two, less, more, share


def load_frames(folder: Path, shards: tuple[int, ...]) -> list[Frame]:
    """Frames of the shards that are there."""
    frames = []
    for shard in shards:
        if WINDOWS.exists(folder, shard):
            arrays = WINDOWS.read(folder, shard)
            arrays["shown"][:, : 2 * BINS] *= np.float16(_LARGER)
            truth = np.stack([arrays[name] for name in ("two", "less", "more", "share")], 1)
            pairs = zip(arrays["shown"], truth.astype(np.float16), strict=True)
            frames += [Frame(*pair) for pair in pairs]
    return frames


def batches(frames: list[Frame], seed: int) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Parts of frames in random order, turned at random, and their truth, without an end."""
    random = np.random.default_rng(seed)
    for some in shuffled(frames, _BATCH, random):
        shown, truth = [], []
        for frame in some:
            down, right = random.integers(CELLS - _PART + 1, size=2)
            flip, turns = random.random() < 0.5, int(random.integers(4))
            at = np.s_[:, down : down + _PART, right : right + _PART]
            shown.append(turned(frame.shown[at], flip, turns))
            truth.append(turned(frame.truth[at], flip, turns))
        yield _tensor(shown), _tensor(truth)


def _tensor(arrays: list[np.ndarray]) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays).astype(np.float32))


def _outputs(network: nn.Module, shown: torch.Tensor) -> torch.Tensor:
    """What the network says of every cell [batch, channels, rows, columns]."""
    return functional.pixel_shuffle(network(shown), 2)


def _loss(
    network: nn.Module, batch: tuple[torch.Tensor, torch.Tensor]
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """What is wrong of whether there are two, of both blur sizes, and of the share."""
    shown, truth = batch
    outputs = _outputs(network, shown)
    two, less, more, share = truth.unbind(1)
    known, are_two = (two >= 0).float(), (two == 1).float()
    count = are_two.sum().clamp(min=1)

    def crossed(logits: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        return functional.binary_cross_entropy_with_logits(logits, right, reduction="none")

    def of_sizes(logits: torch.Tensor, size_px: torch.Tensor) -> torch.Tensor:
        # Two-hot: a truth between two bins belongs to both.
        place = (size_px / BLUR_STEP_PX).clamp(0, BINS - 1.001)
        below = place.floor()
        low, high = (
            functional.log_softmax(logits, 1).gather(1, below.long()[:, None] + step)[:, 0]
            for step in (0, 1)
        )
        return -(((1 - place + below) * low + (place - below) * high) * are_two).sum() / count

    parts = {
        "two": (crossed(outputs[:, -2], two.clamp(min=0)) * known).sum() / known.sum(),
        "less": of_sizes(outputs[:, :BINS], less),
        "more": of_sizes(outputs[:, BINS : 2 * BINS], more),
        "share": (crossed(outputs[:, -1], share) * are_two).sum() / count,
    }
    of_sizes_both = parts["less"] + parts["more"]
    total = _TWO_FACTOR * parts["two"] + _SIZES_FACTOR * of_sizes_both
    return total + _SHARE_FACTOR * parts["share"], parts


def _evaluated(network: nn.Module, frames: list[Frame]) -> tuple[torch.Tensor, torch.Tensor]:
    """Outputs of a network of whole frames, and the truth; [frames, channels, rows, columns]."""
    outputs = []
    with torch.no_grad():
        for start in range(0, len(frames), _BATCH):
            some = frames[start : start + _BATCH]
            shown = _tensor([frame.shown for frame in some]).to(device_of(network))
            outputs.append(_outputs(network, shown).cpu())
    return torch.cat(outputs), _tensor([frame.truth for frame in frames])


def _least_odds(outputs: torch.Tensor, truth: torch.Tensor, false_alarms: float) -> float:
    """Odds that a share of the windows with one surface are above."""
    return float(torch.quantile(outputs[:, -2][truth[:, 0] == 0][::7], 1 - false_alarms))


def _score(network: nn.Module, held_back: list[Frame]) -> dict[str, float]:
    """Shares of the pairs that are found, and found with both sizes right, at some false alarms."""
    outputs, truth = _evaluated(network, held_back)
    two, less, more, _ = truth.unbind(1)
    right = torch.ones_like(two, dtype=torch.bool)
    for place, true in ((0, less), (BINS, more)):
        size_px = outputs[:, place : place + BINS].argmax(1) * BLUR_STEP_PX
        right &= (size_px - true).abs() <= 1
    scores = {}
    for share in _FALSE_ALARMS:
        found = (outputs[:, -2] > _least_odds(outputs, truth, share))[two == 1]
        scores[f"found_{share:g}"] = float(found.float().mean())
        scores[f"right_{share:g}"] = float((found & right[two == 1]).float().mean())
    return {name: round(value, 4) for name, value in scores.items()}


def shipped_network(path: Path) -> Second:
    """Network of a weights' file in the form in which it can be fitted further."""
    weights = onnx_weights(read_weights(path, package)["second_onnx"])
    stem = weights["stem.0.weight"].copy()
    stem[:, : 2 * BINS] /= _LARGER
    network = Second(stem.shape[1])
    load_folded(network, weights | {"stem.0.weight": stem})
    return network


class SecondTask(Task):
    """Fit what tells two surfaces."""

    module = package

    def problem(self, options: Options) -> Problem:
        frames = load_frames(options.folder, options.shards)
        held_back = load_frames(options.folder, options.held_back)
        check_enough(frames, held_back, _BATCH, 1)
        network = Second(len(frames[0].shown))
        if options.further:
            network = shipped_network(options.further).to(options.device)
            some = itertools.islice(batches(frames, 0), _RENORMALISED_BATCHES)
            renormalise(network, ((shown.to(options.device),) for shown, _ in some))
        rate = options.rate or (_FURTHER_RATE if options.further else _RATE)
        return Problem(
            network,
            Schedule(options.minutes, rate, warm_steps=100, decay=1e-3),
            lambda seed: batches(frames, seed),
            _loss,
            lambda average: _score(average, held_back),
        )

    def arrays(self, weights: dict[str, torch.Tensor], options: Options) -> dict[str, Any]:
        network = Second(weights["stem.0.weight"].shape[1])
        network.load_state_dict(weights)
        fold(network)
        # The package gives probabilities as they are.
        network.stem[0].weight.data[:, : 2 * BINS] *= _LARGER
        round_weights(network)
        shown = torch.zeros(1, network.stem[0].in_channels, _ROWS, _COLUMNS)
        return {"second_onnx": to_onnx(network, {"shown": shown}, "told")}

    def calibration(self, options: Options) -> dict[str, Any]:
        held_back = load_frames(options.folder, options.held_back)
        check_enough(held_back, held_back, 1, 1)
        network = shipped_network(options.weights).eval()
        outputs, truth = _evaluated(network, held_back)
        odds = _least_odds(outputs, truth, _CALIBRATED_FALSE_ALARMS)
        print(f"least odds: {odds:.3f}, for {_CALIBRATED_FALSE_ALARMS:.0%} false alarms")
        return {"least_odds": np.array(odds, np.float32)}
