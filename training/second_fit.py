"""Fit the network of second surfaces, and write it in the form that the package runs.

python training/second_fit.py --shown DIR --shards 4 30 84 106 200 260 --validate 28 30 104 106 \
    --minutes 22 -o second.npz

With --further, a network that was written before is fitted on, at a lower rate.
"""

import argparse
import dataclasses
import hashlib
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from batches import ahead
from coded_aperture_benchmarks.metrics.surfaces import BINS
from export import rounded, written
from network import Around, convolution
from shards import shards_of
from torch import nn
from torch.nn import functional

from coded_aperture_ros.core.archive import write_archive
from coded_aperture_ros.depth.decoders.network.features import BLUR_STEP_PX
from coded_aperture_ros.depth.decoders.network.second import CHANNELS, SCHEMA, SCHEMA_VERSION

_BATCH, _PART, _REPORT_S = 16, 36, 60
_FURTHER_RATE = 6e-4
_RATE, _DECAY, _WARM_UP, _AVERAGE = 2e-3, 1e-3, 100, 0.998
_CELL, _SQUARE, _DISTANCES = 48, 64, (1, 2, 1)
# Probabilities are small numbers beside the rest.
_LARGER = 4.0
# Whether there are two counts the most, then which, then their shares.
_OF_TWO, _OF_SIZES, _OF_SHARE = 2.0, 0.5, 0.3
_FALSE_ALARMS = (0.02, 0.05)
_ROWS, _COLUMNS = 60, 80


class Second(nn.Module):
    """From cells of 8 px to squares of 16 px, and what is around them."""

    def __init__(self, shown: int) -> None:
        super().__init__()
        self.probabilities = 2 * BINS
        self.stem = convolution(shown, _CELL)
        self.down = convolution(_CELL, _SQUARE, 3, 2)
        self.around = nn.Sequential(*(Around(_SQUARE, far) for far in _DISTANCES))
        self.out = nn.Conv2d(_SQUARE, 4 * CHANNELS, 1)

    def forward(self, shown: torch.Tensor) -> torch.Tensor:
        """Return what is told of the four cells of each square, one after the other."""
        told: torch.Tensor = self.out(self.around(self.down(self.stem(shown))))
        return told


def written_before(path: Path, shown: int) -> Second:
    """Return a network from its file: normalisations are in its convolutions already."""
    import onnx

    graph = onnx.load_from_string(np.load(path)["second_onnx"].tobytes()).graph
    weights = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    network = Second(shown)
    for module in (network.stem, network.down):
        module[0], module[1] = _with_bias(module[0]), nn.Identity()
    for around in network.around:
        around.spatial, around.norm = _with_bias(around.spatial), nn.Identity()
    layers = [module for module in network.modules() if isinstance(module, nn.Conv2d)]
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    for layer, node in zip(layers, nodes, strict=True):
        for parameter, name in zip((layer.weight, layer.bias), node.input[1:], strict=True):
            parameter.data = torch.from_numpy(weights[name].copy())
    network.stem[0].weight.data[:, : 2 * BINS] /= _LARGER
    return network


def _with_bias(layer: nn.Conv2d) -> nn.Conv2d:
    how = layer.kernel_size, layer.stride, layer.padding, layer.dilation
    return nn.Conv2d(layer.in_channels, layer.out_channels, *how)


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """What is shown of a frame, and what is true: see `second_shown`."""

    shown: np.ndarray
    truth: np.ndarray  # [4, cells, cells]: two, less, more, share


def load(folder: Path, shards: Sequence[int]) -> list[Frame]:
    """Read the shards that are there."""
    frames = []
    for path in (folder / f"second_{shard:04d}.npz" for shard in shards):
        if path.exists():
            arrays = np.load(path)
            shown = arrays["shown"].astype(np.float16)
            shown[:, : 2 * BINS] *= np.float16(_LARGER)
            truth = np.stack([arrays[name] for name in ("two", "less", "more", "share")], 1)
            frames += [Frame(*each) for each in zip(shown, truth.astype(np.float16), strict=True)]
    return frames


def batches(frames: list[Frame], random: np.random.Generator) -> Iterator[torch.Tensor]:
    """Yield parts of random frames, turned and mirrored: what is shown and what is true."""
    while True:
        parts = []
        for index in random.integers(len(frames), size=_BATCH):
            frame, (down, right) = frames[index], random.integers(40 - _PART + 1, size=2)
            whole = np.concatenate([frame.shown, frame.truth]).astype(np.float32)
            part = whole[:, down : down + _PART, right : right + _PART]
            part = part[..., ::-1] if random.random() < 0.5 else part
            parts.append(np.rot90(part, int(random.integers(4)), (1, 2)).copy())
        yield torch.from_numpy(np.stack(parts))


def losses(told: torch.Tensor, truth: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return what was wrong of whether there are two, of both blur sizes, and of the share."""
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

    return (
        (crossed(told[:, -2], two.clamp(min=0)) * known).sum() / known.sum(),
        of_sizes(told[:, :BINS], less),
        of_sizes(told[:, BINS : 2 * BINS], more),
        (crossed(told[:, -1], share) * are_two).sum() / count,
    )


def report(network: Second, frames: list[Frame]) -> str:
    """Say how many pairs are found in frames held back, at some shares of false alarms."""
    network.eval()
    told, truth = [], []
    with torch.no_grad():
        for start in range(0, len(frames), _BATCH):
            some = frames[start : start + _BATCH]
            shown = torch.from_numpy(np.stack([one.shown for one in some]).astype(np.float32))
            told.append(functional.pixel_shuffle(network(shown), 2))
            truth.append(torch.from_numpy(np.stack([one.truth for one in some])).float())
    network.train()
    two, less, more, _ = torch.cat(truth).unbind(1)
    all_told = torch.cat(told)
    odds = all_told[:, -2]
    right = torch.ones_like(odds, dtype=torch.bool)
    for place, true in ((0, less), (BINS, more)):
        size_px = all_told[:, place : place + BINS].argmax(1) * BLUR_STEP_PX
        right &= (size_px - true).abs() <= 1
    parts = []
    for share in _FALSE_ALARMS:
        least = torch.quantile(odds[two == 0][::7], 1 - share)
        found = (odds > least)[two == 1]
        both = found & right[two == 1]
        parts.append(
            f"{100 * share:g} % false alarms above {least:.2f}: {100 * found.float().mean():.1f} % "
            f"found, {100 * both.float().mean():.1f} % with both right"
        )
    return "; ".join(parts)


def main() -> None:
    """Fit for some minutes, report every minute, and write the network."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shown", type=Path, required=True, help="from second_shown.py")
    pairs = "first and last + 1; several such pairs, one after the other"
    for name in ("--shards", "--validate"):
        parser.add_argument(name, type=int, nargs="+", required=True, help=pairs)
    parser.add_argument("--minutes", type=float, required=True)
    parser.add_argument("--further", type=Path, metavar="NPZ", help="fit this one on")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    held_back = shards_of(args.validate)
    learned = [shard for shard in shards_of(args.shards) if shard not in held_back]
    frames, others = load(args.shown, learned), load(args.shown, held_back)
    print(f"{len(frames)} frames, {len(others)} held back", flush=True)
    torch.manual_seed(0)
    shown = frames[0].shown.shape[0]
    network = written_before(args.further, shown) if args.further else Second(shown)
    rate = _FURTHER_RATE if args.further else _RATE
    average = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(_AVERAGE), use_buffers=True
    )
    optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=_DECAY)
    start = reported = time.perf_counter()
    for step, batch in enumerate(ahead(batches(frames, np.random.default_rng(0)))):
        now = time.perf_counter()
        done = (now - start) / (60 * args.minutes)
        if done >= 1:
            break
        for group in optimizer.param_groups:
            cooled = 0.5 + 0.5 * math.cos(math.pi * done)
            group["lr"] = rate * min(1, (step + 1) / _WARM_UP) * cooled
        told = functional.pixel_shuffle(network(batch[:, :-4]), 2)
        two, less, more, share = losses(told, batch[:, -4:])
        optimizer.zero_grad()
        (_OF_TWO * two + _OF_SIZES * (less + more) + _OF_SHARE * share).backward()
        optimizer.step()
        average.update_parameters(network)
        if now - reported > _REPORT_S:
            reported = now
            print(
                f"{(now - start) / 60:.0f} min, {step}: {report(average.module, others)}",
                flush=True,
            )
    print(report(average.module, others))
    _write(average.module.eval(), args.output)


def _fused(layer: nn.Conv2d, norm: nn.Module) -> nn.Conv2d:
    if isinstance(norm, nn.Identity):
        return layer
    return nn.utils.fusion.fuse_conv_bn_eval(layer, norm)


def _write(network: Second, path: Path) -> None:
    """Write the network, which takes probabilities as they are, without normalisations."""
    for module in (network.stem, network.down):
        module[0], module[1] = _fused(module[0], module[1]), nn.Identity()
    for around in network.around:
        around.spatial, around.norm = _fused(around.spatial, around.norm), nn.Identity()
    network.stem[0].weight.data[:, : 2 * BINS] *= _LARGER
    for parameter in network.parameters():
        parameter.data = rounded(parameter.data)
    shown = torch.zeros(1, network.stem[0].in_channels, _ROWS, _COLUMNS)
    arrays = {"second_onnx": written(network, (shown,), ["shown"], "told")}
    write_archive(path, SCHEMA, SCHEMA_VERSION, arrays)
    packed = path.read_bytes()
    count = sum(parameter.numel() for parameter in network.parameters())
    print(f"{count} weights, {len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


if __name__ == "__main__":
    main()
