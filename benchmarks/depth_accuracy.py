"""Depth and deblurring on ray-traced scenes and on a real photograph.

The bank is learned from the mask and the camera alone. The real photograph shows a flat page; nine
measured PSFs compete at every position, and one of them is its own.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, bank_for
from coded_aperture_benchmarks.scripts import data_folder, data_parser, exit_status, print_rows

from coded_aperture_ros.deblur import Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.metrics import depth_error, psnr_db
from coded_aperture_ros.optics import PsfStack

SCENES = ("desk", "corridor")
NOISE = 0.002
LEVELS = 30
EDGE_REACH_PX = 16
# Every pixel has a depth here, so that the error is not made small by leaving pixels out.
EVERYWHERE = 0.0


def measure_scene(
    folder: Path,
    mask: str = "levin",
    noise: float = NOISE,
    seed: int = 0,
    regularize: str = "semiglobal",
) -> dict[str, Any]:
    """Measure one ray-traced scene with noise added."""
    scene = RayTracedScene.load(folder, mask)
    depth = scene.depth_m
    bank = bank_for(scene.camera, depth, LEVELS)
    random = np.random.default_rng(seed)
    coded = scene.coded + random.normal(0, noise, scene.coded.shape).astype(np.float32)
    config = DepthConfig(confidence_threshold=EVERYWHERE, regularize=regularize)
    estimate = DepthEstimator(bank, config, scene.camera).estimate(coded)
    assert estimate.depth_m is not None  # there is a camera
    sharp = Deblurrer(bank.stack).deblur(coded, estimate.blur_size_px)

    away = scene.edge_distance_px() > EDGE_REACH_PX
    error = np.abs(estimate.depth_m - depth) / depth
    confident = depth_error(estimate.depth_m, estimate.confidence, depth, 0.7)
    return {
        "scene": folder.name,
        "mask": mask,
        "regularize": regularize,
        "median_error_confident_70": round(confident.median_relative, 4),
        "median_error_all": round(float(np.nanmedian(error)), 4),
        "median_error_away": round(float(np.nanmedian(error[away])), 4),
        "median_error_near_edges": round(float(np.nanmedian(error[~away])), 4),
        "psnr_coded_away_db": round(psnr_db(coded[away], scene.sharp[away]), 2),
        "psnr_sharp_away_db": round(psnr_db(sharp[away], scene.sharp[away]), 2),
        "gain_away_db": round(
            psnr_db(sharp[away], scene.sharp[away]) - psnr_db(coded[away], scene.sharp[away]), 2
        ),
        "gain_all_db": round(psnr_db(sharp, scene.sharp) - psnr_db(coded, scene.sharp), 2),
    }


def measure_photograph(folder: Path) -> dict[str, Any]:
    """Count the positions at which the photograph's own PSF is chosen among nine."""
    with np.load(folder / "levin_letters.npz") as photograph:
        image, own = photograph["image"], photograph["psf"]
    with np.load(folder / "measured_psfs.npz") as measured:
        psfs = np.concatenate([measured["psfs"], own[None]])
    psfs = psfs / psfs.sum(axis=(1, 2), keepdims=True)
    stack = PsfStack(np.arange(float(len(psfs))), psfs.astype(np.float32), in_pixels=False)
    config = DepthConfig(confidence_threshold=EVERYWHERE, stride_px=4)
    estimate = DepthEstimator(learn_bank(stack), config).estimate(image.astype(np.float32))
    right = np.rint(estimate.level) == len(psfs) - 1
    return {"scene": "photograph", "positions": right.size, "right": round(float(right.mean()), 5)}


def main() -> int:
    """Print the tables."""
    parser = data_parser(__doc__, "rendered/ and real_photo/")
    parser.add_argument(
        "--masks", nargs="+", default=["levin"], help="levin, four_hole, disk (default levin)"
    )
    parser.add_argument("--noise", type=float, default=NOISE, help=f"added noise (default {NOISE})")
    args = parser.parse_args()
    data = data_folder(parser, args)

    def measure() -> None:
        photograph = measure_photograph(data / "real_photo")
        scenes = [
            measure_scene(data / "rendered" / scene, mask, args.noise, regularize=regularize)
            for mask in args.masks
            for scene in SCENES
            for regularize in ("none", "semiglobal", "tv", "graphcut")
        ]
        if args.json:
            print(json.dumps({"photograph": photograph, "scenes": scenes}, indent=2))
            return
        print(f"photograph: own PSF chosen at {100 * photograph['right']:.2f} % of the pixels\n")
        print_rows(scenes, as_json=False)

    return exit_status(measure)


if __name__ == "__main__":
    sys.exit(main())
