"""Score a network on scenes with known depth, worst first.

example:
  python training/score_raw.py build/raw/any_average.pt --network any --mask levin scenes/desk
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import torch
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from fit_raw import ONE_SIZES_PX, blur_sizes
from raw.cameras import Camera as RandomCamera
from raw.evidence import evidence, transfer_functions
from raw.network import LEVELS, AnyOptics, OneOptics
from torch.nn import functional

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Camera, Mask

_MULTIPLE_PX = 32
_NEAR_EDGE_PX = 16
_WITHIN = 0.1
# Masks of the package are the scenes' without their closed border.
_BORDERED = {"levin", "zhou"}
_BORDER = 11 / 13


def _camera(scene: RayTracedScene, mask: str) -> tuple[RandomCamera, float, float]:
    """Camera as networks know it, and blur in px at infinity and times metres of depth."""
    camera: Camera = scene.camera
    share = _BORDER if mask in _BORDERED else 1.0
    pattern = Mask.named(mask) if mask in _BORDERED else camera.mask
    infinity = camera.blur_at_infinity_px * share
    sizes = camera.blur_size_px(scene.depth_m) * share
    low, high = np.nanmin(sizes), np.nanmax(sizes)
    levels = np.linspace(
        max(min(abs(low), abs(high)) - 0.4, 0.3),
        max(abs(low), abs(high)) + 0.4,
        LEVELS,
        dtype=np.float32,
    )
    return RandomCamera(pattern, float(low), float(high), levels), infinity, share


def estimate(
    network: torch.nn.Module, kind: str, frame: FloatArray, camera: RandomCamera, noise: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Blur size of every pixel, and probabilities [levels, rows, columns] of the sizes given."""
    rows, columns = frame.shape[:2]
    frames = torch.from_numpy(frame.transpose(2, 0, 1).copy())[None].float()
    down, right = (-rows % _MULTIPLE_PX, -columns % _MULTIPLE_PX)
    frames = functional.pad(frames, (0, right, 0, down), "reflect")
    psfs = torch.from_numpy(camera.psfs())
    given = evidence(frames, torch.tensor([noise]), transfer_functions(psfs, frames.shape[-2:]))
    sizes = torch.from_numpy(camera.sizes_px)[None]
    with torch.no_grad():
        logits = network(given, sizes, torch.tensor([float(camera.near)]))
    if kind == "one":
        sizes = torch.from_numpy(ONE_SIZES_PX)[None]
        tried = (sizes >= camera.sizes_px[0] - 0.8) & (sizes <= camera.sizes_px[-1] + 0.8)
        logits = logits.masked_fill(~tried[:, :, None, None], -1e4)
    found = blur_sizes(logits, sizes)[0].numpy()
    shares = functional.softmax(logits, 1)[0].numpy()
    found = found.repeat(2, 0).repeat(2, 1)[:rows, :columns]
    return found, shares.repeat(2, 1).repeat(2, 2)[:, :rows, :columns], sizes[0].numpy()


def score(network: torch.nn.Module, kind: str, folder: Path, mask: str, noise: float) -> dict:
    """Row of a scene."""
    scene = RayTracedScene.load_views(folder, mask, 1)[0]
    camera, infinity, share = _camera(scene, mask)
    random = np.random.default_rng(0)
    frame = scene.coded + noise * random.standard_normal(scene.coded.shape, dtype=np.float32)
    started = time.perf_counter()
    size, shares, sizes = estimate(network, kind, frame.astype(np.float32), camera, noise)
    seconds = time.perf_counter() - started
    signed = size * (-1 if camera.near else 1)
    # Blur is linear in inverse depth.
    true_px = scene.camera.blur_size_px(scene.depth_m) * share
    scale = infinity - signed
    error = np.abs((infinity - true_px) / scale - 1)
    known = np.isfinite(true_px)
    right = (error <= _WITHIN) & known
    signs = -1 if camera.near else 1
    off = np.abs((infinity - signs * sizes[:, None, None]) / scale - 1)
    confidence = (shares * (off <= _WITHIN)).sum(0)
    edge = scene.edge_distance_px() <= _NEAR_EDGE_PX
    published = (confidence >= 0.55) & known
    count = np.count_nonzero(known)
    return {
        "scene": folder.name,
        "mask": mask,
        "every": round(100 * right.sum() / count, 1),
        "near": round(100 * right[edge & known].mean(), 1) if (edge & known).any() else math.nan,
        "published": round(100 * published.sum() / count, 1),
        "right_of_published": round(100 * right[published].mean(), 1) if published.any() else 0.0,
        "both": round(100 * (right & published).sum() / count, 1),
        "median": round(100 * float(np.median(error[known])), 2),
        "said": round(100 * float(confidence[known].mean()), 1),
        "seconds": round(seconds, 2),
    }


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("weights", type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--network", choices=("any", "one"), default="any")
    parser.add_argument("--masks", nargs="+", default=["levin"])
    parser.add_argument("--noise", type=float, default=0.002)
    options = parser.parse_args()
    network = {"any": AnyOptics, "one": OneOptics}[options.network]().eval()
    state = torch.load(options.weights, weights_only=True, map_location="cpu")
    network.load_state_dict({name: value.float() for name, value in state.items()})
    rows = []
    for mask in options.masks:
        for folder in options.folders:
            if (folder / f"coded_{mask}_linear.png").exists():
                rows.append(score(network, options.network, folder, mask, options.noise))
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    for row in sorted(rows, key=lambda row: row["every"]):
        print(json.dumps(row))


if __name__ == "__main__":
    main()
