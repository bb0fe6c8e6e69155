"""How exact a camera is known after calibration from planes of known depth.

From 16 ray-traced planes with noise, with and without knowing the mask: blur sizes, focus, time,
and the depth error of the bank on another scene of that camera, beside the bank of the true mask.
With --psf instead: the error of PSFs from simulated pictures of dots.
"""

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, scene_camera
from coded_aperture_benchmarks.scripts import data_folder, data_parser, exit_status, print_rows

from coded_aperture_ros.calibration.planes.calibrate import calibrate_planes
from coded_aperture_ros.calibration.planes.folder import load_planes
from coded_aperture_ros.calibration.psf.dots import psf_from_dots
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.remap import remap_bank
from coded_aperture_ros.optics import Mask, render_psf

NOISE = 0.002
LEVELS = 40
FRAMES = 8
PSF_SIZES = (3.0, 4.0, 5.0, 7.3, 10.0, 16.0)
PSF_MASKS = ("levin", "zhou", "four_hole", "disc")


def open_part(camera: Any) -> float:
    """Return the width of a mask's open part over that of its grid."""
    cells = camera.mask.transmission > 0
    spans = [np.ptp(np.flatnonzero(cells.any(axis=axis))) + 1 for axis in (0, 1)]
    return float(max(spans) / max(cells.shape))


def median_depth_error(bank: FilterBank, views: list[RayTracedScene]) -> float:
    """Median relative error of all pixels of some frames with noise."""
    random = np.random.default_rng(1)
    errors = []
    for view in views:
        coded = view.coded + random.normal(0, NOISE, view.coded.shape).astype(np.float32)
        estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), view.camera)
        found = estimator.estimate(coded).depth_m
        assert found is not None  # the bank has depths
        errors.append(np.abs(found / view.depth_m - 1).ravel())
    return float(np.nanmedian(np.concatenate(errors)))


def measure(data: Path, seed: int, known_mask: bool) -> dict[str, Any]:
    """Calibrate once."""
    folder = data / "rendered" / "calib"
    planes = load_planes([folder])
    random = np.random.default_rng(seed)
    planes = dataclasses.replace(
        planes,
        images=tuple(
            (image + random.normal(0, NOISE, image.shape)).astype(np.float32)
            for image in planes.images
        ),
    )
    camera = scene_camera(folder, "levin")
    started_s, processor_s = time.perf_counter(), time.process_time()
    found = calibrate_planes(
        planes, LEVELS, LearnConfig(), mask=camera.mask if known_mask else None
    )
    took_s = time.perf_counter() - started_s
    took_processor_s = time.process_time() - processor_s
    listed = json.loads((folder / "planes.json").read_text())
    true_px = np.array([entry["psf_width_px"] for entry in listed])
    # A mask by its name is the open part of the rendered mask, which has a closed rim.
    true_px = true_px * (1.0 if known_mask else open_part(camera))
    error_px = found.pattern.blur_size_px(planes.depths_m) - true_px
    measured_px = np.array([plane.size_px for plane in found.measured]) - true_px
    near_m, far_m = planes.depths_m[[0, -1]]
    views = RayTracedScene.load_views(data / "rendered" / "video", "levin", FRAMES)
    of_planes = median_depth_error(found.bank, views)
    of_mask = median_depth_error(learn_bank_for_camera(camera, near_m, far_m, LEVELS), views)
    remapped = remap_bank(found.bank, camera, near_m, far_m, LEVELS)
    return {
        "mask": "known" if known_mask else f"found: {found.pattern.mask.name}",
        "seconds": round(took_s, 1),
        "processor_seconds": round(took_processor_s, 1),
        "blur_rms_px": round(float(np.sqrt(np.mean(error_px**2))), 3),
        "blur_measured_rms_px": round(float(np.sqrt(np.mean(measured_px**2))), 3),
        "focus_m": round(found.pattern.focus_distance_m, 4),
        "focus_error_percent": round(
            100 * abs(found.pattern.focus_distance_m / camera.focus_distance_m - 1), 2
        ),
        "left_out_error_percent": round(100 * float(np.median(found.left_out.errors)), 2),
        "left_out_window_error_percent": round(
            100 * float(np.median(found.left_out.window_errors)), 2
        ),
        "video_error_percent": round(100 * of_planes, 2),
        "video_error_true_mask_percent": round(100 * of_mask, 2),
        "video_error_remapped_percent": round(100 * median_depth_error(remapped, views), 2),
    }


def dot_picture(mask: Mask, blur_size_px: float, seed: int) -> np.ndarray:
    """Simulate a grid of lights: 0.3 px off it, noise, vignetting, uneven background light."""
    random = np.random.default_rng(seed)
    height, width, margin, half = 480, 640, 60, 20
    turn = np.deg2rad(1.7)
    basis = 44.3 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = np.mgrid[-14:15, -14:15].reshape(2, -1).T @ basis + [height / 2, width / 2]
    points = points[((points > -half) & (points < [height + half, width + half])).all(axis=1)]
    points += 0.3 * random.standard_normal(points.shape)
    light = np.zeros((height + 2 * margin, width + 2 * margin))
    strength = 0.5 / render_psf(mask, blur_size_px, 2 * half + 1, (0.25, 0.25)).max()
    for y, x in points:
        row, column = round(y), round(x)
        top, left = row + margin - half, column + margin - half
        psf = render_psf(mask, blur_size_px, 2 * half + 1, (y - row, x - column))
        light[top : top + 2 * half + 1, left : left + 2 * half + 1] += strength * psf
    light = light[margin:-margin, margin:-margin]
    rows, columns = np.meshgrid(
        np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij"
    )
    scene = (light + 0.04) * (1 - 0.15 * (rows**2 + columns**2)) + 0.01 * columns
    return np.clip(scene + NOISE * random.standard_normal(scene.shape), 0, 1)


def measure_psfs(name: str, seed: int) -> dict[str, Any]:
    """Return the errors of a mask's PSFs of several blur sizes from dots, in percent."""
    mask = Mask.named(name)
    row: dict[str, Any] = {"mask": name}
    for size in PSF_SIZES:
        measured = psf_from_dots(dot_picture(mask, size, seed), mask)
        centred = measured.centred(mask)
        true = render_psf(mask, size, 25)
        error = np.linalg.norm(centred.psf(25) - true) / np.linalg.norm(true)
        row[f"{size:g} px"] = round(100 * float(error), 2)
        row[f"field at {size:g} px"] = round(100 * measured.field_variation, 2)
    return row


def main() -> int:
    """Print the table."""
    parser = data_parser(__doc__, "rendered/")
    parser.add_argument("--seeds", type=int, default=1, help="how many draws of noise (default 1)")
    parser.add_argument("--psf", action="store_true", help="measure PSFs from dots instead")
    args = parser.parse_args()
    data = None if args.psf else data_folder(parser, args)

    def measure_all() -> None:
        seeds = range(args.seeds)
        if data is None:
            rows = [measure_psfs(name, seed) for seed in seeds for name in PSF_MASKS]
        else:
            rows = [measure(data, seed, known) for seed in seeds for known in (False, True)]
        print_rows(rows, args.json, across=False)

    return exit_status(measure_all)


if __name__ == "__main__":
    sys.exit(main())
