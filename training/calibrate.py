"""Fit the standard deviation of the refinement, on frames that it has not learned from.

    python training/calibrate.py --scenes DIR --costs DIR --shards 0 4 80 84

Prints the constant `deviation` of `refinement.npz`, and how well its confidence,
which `calibrate_frames.py` fits, holds on these small frames with the flaws of cameras.
"""

import argparse
from pathlib import Path

import numpy as np
from batches import Frame, load, true_blur_px
from shards import shards_of

from coded_aperture_ros.core.archive import read_archive
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network import network as network_module
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX
from coded_aperture_ros.depth.decoders.network.network import (
    SCHEMA,
    SCHEMA_VERSION,
    WEIGHTS,
    Calibration,
    Network,
)
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells

_WEIGHTS = Path(network_module.__file__).with_name(WEIGHTS)
_PUBLISHED = 0.55
_LEAST_PX = 1e-3


def measured(frame: Frame) -> dict[str, np.ndarray]:
    """Return for every half-cell in the frame what was found and how wrong it is."""
    network = Network(frame.tried, Workers())
    logits = network(*(v.astype(np.float32) for v in (frame.costs, frame.frame)))
    found = HalfCells.of(logits, BLUR_SIZES_PX[frame.tried].astype(np.float32))
    truth = true_blur_px(frame)[2::4, 2::4]
    tolerance = 0.05 * np.abs(frame.infinity_px - np.sign(truth) * found.size_px)
    probability = found.right_within(np.nan_to_num(tolerance).astype(np.float32))
    known = np.isfinite(truth)
    return {
        "probability": probability[known],
        "size": found.size_px[known],
        "error": np.abs(found.size_px - np.abs(truth))[known],
        "tolerance": tolerance[known],
        "deviation": found.deviation_px()[known],
    }


def main() -> None:
    """Fit and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--costs", type=Path, required=True)
    parser.add_argument("--shards", type=int, nargs="+", default=(0, 4))
    args = parser.parse_args()
    frames = load(args.scenes, args.costs, shards_of(args.shards))
    if not frames:
        raise SystemExit("no frames: --scenes, --costs and --shards name none that are there")
    each = [measured(frame) for frame in frames]
    found = {name: np.concatenate([one[name] for one in each]) for name in each[0]}
    right = found["error"] <= found["tolerance"]
    calibration = Calibration.from_weights(read_archive(_WEIGHTS, SCHEMA, SCHEMA_VERSION))
    confidence = calibration.confidence(
        found["probability"], found["size"], np.maximum(found["tolerance"], _LEAST_PX)
    )
    published = confidence >= _PUBLISHED
    factor = np.quantile((found["error"] / found["deviation"])[published], 0.68)
    print(f"deviation = {factor:.3f}")
    twice = found["error"] <= 2 * found["tolerance"]
    print(f"right to 5 %: {right.mean():.3f}, to 10 %: {twice.mean():.3f}")
    print(f"published {published.mean():.3f}, of these to 10 %: {twice[published].mean():.3f}")
    for low in np.arange(0, 1, 0.1):
        part = (confidence >= low) & (confidence < low + 0.1)
        if part.any():
            means = (confidence[part].mean(), right[part].mean(), part.mean())
            print(f"{low:.1f}: " + " ".join(f"{mean:.3f}" for mean in means))


if __name__ == "__main__":
    main()
