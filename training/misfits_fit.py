"""Fit the network of the check of fit, and write it in the form that the package reads.

python training/misfits_fit.py --misfits DIR -o coded_aperture_ros/depth/quality/fit.npz
"""

import argparse
import hashlib
from pathlib import Path

import numpy as np
import torch

from coded_aperture_ros.core.archive import write_archive
from coded_aperture_ros.depth import CAUSES
from coded_aperture_ros.depth.quality.health import (
    FITS,
    LIMIT,
    SCALED_LIMIT,
    SCHEMA,
    SCHEMA_VERSION,
)

# One shard in so many is only looked at.
_HELD_BACK, _OF = 7, 8
_HIDDEN, _EPOCHS, _BATCH = 256, 60, 256
# So many networks, from other beginnings, are asked, and what they say is averaged.
_MEMBERS = 4
# How much fitting frames, and wrong depth that would be published, count beside the rest.
_OF_FITS, _OF_WRONG = 12.0, 6.0
# What is the easiest to overlook counts so many times, where its depth is wrong.
_OVERLOOKED = {"all in focus": 15.0, "no mask": 4.0} | dict.fromkeys(
    ("smoothed", "enlarged linearly", "other mask", "correlated noise", "mask inverted"), 2.0
)
_COVERED = 0.1
# What is published is right if its error exceeds that of the same scene, where it fits, by less
# than the first, and wrong from the second on: many scenes are near infinity, and hard to measure.
_RIGHT, _WRONG = 0.06, 0.12
_NOISE, _DROPPED = 0.2, 0.5


class _Network(torch.nn.Sequential):
    def __init__(self, inputs: int) -> None:
        super().__init__(
            torch.nn.Linear(inputs, _HIDDEN),
            torch.nn.ReLU(),
            torch.nn.Dropout(_DROPPED),
            torch.nn.Linear(_HIDDEN, _HIDDEN // 2),
            torch.nn.ReLU(),
            torch.nn.Linear(_HIDDEN // 2, 1 + len(CAUSES)),
        )


def read(folder: Path) -> dict[str, np.ndarray]:
    """Read all shards."""
    paths = sorted(folder.glob("misfits_*.npz"))
    shards = [dict(np.load(path)) for path in paths]
    names = [int(path.stem[-4:]) for path in paths]
    for shard, number in zip(shards, names, strict=True):
        shard["shard"] = np.full(len(shard["error"]), number)
    filled = [shard for shard in shards if len(shard["error"])]
    return {name: np.concatenate([shard[name] for shard in filled]) for name in filled[0]}


def excess(told: dict[str, np.ndarray]) -> np.ndarray:
    """Return by how much the error of what is published exceeds that of the same scene."""
    fits, number = told["cause"] < 0, told["number"]
    count = np.bincount(number[fits], minlength=number.max() + 1)
    total = np.bincount(number[fits], told["error"][fits], minlength=number.max() + 1)
    own = (total / np.maximum(count, 1))[number]
    return np.where(told["coverage"] > _COVERED, told["error"], 0) - own


def targets(told: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return how right each frame is, how much that counts, and the same of its cause."""
    fits = told["cause"] < 0
    wrong = np.where(fits, 0, np.clip((excess(told) - _RIGHT) / (_WRONG - _RIGHT), 0, 1))
    counts = np.where(fits, _OF_FITS, np.where(wrong > 0.5, _OF_WRONG, 1))
    counts[~fits & (told["coverage"] < _COVERED)] = 0.3
    overlooked = np.array([_OVERLOOKED.get(str(kind), 1.0) for kind in told["kind"]])
    counts *= np.where(wrong > 0.5, overlooked, 1)
    cause_counts = np.where(fits, 0, np.where(wrong > 0, 1, 0.3))
    frequency = np.bincount(told["cause"][~fits], minlength=len(CAUSES))
    cause_counts *= (frequency.mean() / np.maximum(frequency, 1))[told["cause"]] ** 0.6
    return 1 - wrong, counts, np.maximum(told["cause"], 0), cause_counts


def fitted(
    values: np.ndarray, told: dict[str, np.ndarray], learned: np.ndarray, seed: int
) -> _Network:
    """Fit a network to standardised features."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    random = np.random.default_rng(seed)
    right, counts, cause, cause_counts = (
        torch.tensor(array if array.dtype.kind == "i" else array.astype(np.float32))
        for array in targets(told)
    )
    inputs = torch.tensor(values)
    network = _Network(values.shape[1])
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=1e-2)
    steps = _EPOCHS * (len(learned) // _BATCH + 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=steps)
    of_health = torch.nn.functional.binary_cross_entropy_with_logits
    of_cause = torch.nn.functional.cross_entropy
    for _ in range(_EPOCHS):
        order = random.permutation(learned)
        for start in range(0, len(order), _BATCH):
            some = order[start : start + _BATCH]
            shown = inputs[some] + _NOISE * torch.randn(len(some), inputs.shape[1])
            outputs = network(shown)
            health = counts[some] * of_health(outputs[:, 0], right[some], reduction="none")
            named = cause_counts[some] * of_cause(outputs[:, 1:], cause[some], reduction="none")
            optimiser.zero_grad()
            (health.mean() + 0.5 * named.mean()).backward()
            optimiser.step()
            schedule.step()
    return network.eval()


def together(networks: list[_Network]) -> dict[str, np.ndarray]:
    """Return weights [members, outputs, inputs] and biases [members, outputs] of every layer."""
    linear = ([part for part in one if isinstance(part, torch.nn.Linear)] for one in networks)
    layers = zip(*linear, strict=True)
    arrays = {}
    for number, members in enumerate(layers):
        arrays[f"weight{number}"] = torch.stack([one.weight.detach() for one in members]).numpy()
        arrays[f"bias{number}"] = torch.stack([one.bias.detach() for one in members]).numpy()
    return arrays


def main() -> None:
    """Fit, write, and print how good it is on frames that were held back."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--misfits", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    told = read(args.misfits)
    features = np.clip(told["features"], -LIMIT, LIMIT)
    held_back = told["shard"] % _OF == _HELD_BACK
    learned = np.flatnonzero(~held_back)
    mean, scale = features[learned].mean(0), features[learned].std(0) + 1e-3
    values = np.clip((features - mean) / scale, -SCALED_LIMIT, SCALED_LIMIT).astype(np.float32)
    networks = [fitted(values, told, learned, seed) for seed in range(_MEMBERS)]
    each = {"mean": np.tile(mean, (_MEMBERS, 1)), "scale": np.tile(scale, (_MEMBERS, 1))}
    arrays = each | together(networks)
    halves = {name: array.astype(np.float16) for name, array in arrays.items()}
    write_archive(args.output, SCHEMA, SCHEMA_VERSION, halves)
    with torch.no_grad():
        outputs = torch.stack([one(torch.tensor(values)) for one in networks]).mean(0).numpy()
    _print_quality(told, outputs, held_back)
    packed = args.output.read_bytes()
    print(f"{len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}")


def _print_quality(told: dict[str, np.ndarray], outputs: np.ndarray, held_back: np.ndarray) -> None:
    alarmed = outputs[:, 0] < np.log(FITS / (1 - FITS))
    fits = told["cause"] < 0
    wrong = ~fits & (excess(told) > 0.1) & (told["coverage"] > 0.2)
    right_cause = outputs[:, 1:].argmax(1) == told["cause"]
    print(f"{len(fits)} frames, {held_back.sum()} of them held back; of these")
    print(f"fitting frames that are said not to fit: {alarmed[held_back & fits].mean():.4f}")
    print(f"wrong depth published: {(wrong & ~alarmed)[held_back & ~fits].mean():.4f}", end=" ")
    print(f"(without the check {wrong[held_back & ~fits].mean():.4f})")
    print(f"cause right: {right_cause[held_back & alarmed & ~fits].mean():.3f}")
    for kind in np.unique(told["kind"][~fits]):
        some = held_back & (told["kind"] == kind)
        if not some.any():
            continue
        named = right_cause[some & alarmed].mean() if (some & alarmed).any() else np.nan
        print(
            f"  {kind:26} {some.sum():4} frames, wrong {wrong[some].mean():.2f} -> "
            f"{(wrong & ~alarmed)[some].mean():.2f}, alarms {alarmed[some].mean():.2f}, "
            f"cause right {named:.2f}"
        )


if __name__ == "__main__":
    main()
