#!/usr/bin/env python3
"""Draw docs/images/trust.jpg: one scene, what befalls its frames, and what depth is published.

    python scripts/draw_trust.py [OUTPUT]

Needs the folder `benchmarks` on the path (make puts it there).
"""

import sys
from collections.abc import Iterator

import cv2
import numpy as np
from coded_aperture_benchmarks.pictures import as_rgb, side_by_side, titled

from coded_aperture_ros.calibration.service.mask import turned
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import SRGB, decode, encode
from coded_aperture_ros.io import depth_picture
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene

_SEED = 1_000_011
_SHAPE = 240, 300
_BLUR_PX = 3.0, 12.0
_SIZES_PX = np.arange(2.0, 16.1, 0.5)
_NOISE = 0.002
_TURN_DEG = 8.0
_REFOCUS = 0.95
_ENLARGED = 1.5
_JPEG_QUALITY = 75
_RIGHT = 0.1
_PICTURE_QUALITY = 80


def main() -> None:
    """Write the picture."""
    output = sys.argv[1] if len(sys.argv) > 1 else "docs/images/trust.jpg"
    mask = Mask.named("levin")
    scene = random_scene(_SEED, mask, shape=_SHAPE, blur_range_px=_BLUR_PX)
    bank = learn_bank(render_psf_stack(mask, _SIZES_PX))
    estimator = DepthEstimator(bank, DepthConfig(), scene.camera)
    true_m = scene.depth_m()
    ends_m = float(true_m.min()), float(true_m.max())
    columns = []
    for name, light, truth_m in frames(scene):
        noisy = light + _NOISE * np.random.default_rng(0).standard_normal(light.shape)
        frame = np.clip(noisy, 0, 1).astype(np.float32)
        if name.startswith("JPEG"):
            frame = compressed(frame)
        estimate = estimator.estimate(frame)
        depth_m = estimate.depth_m
        assert depth_m is not None and estimate.health is not None
        known = np.isfinite(depth_m)
        right = np.abs(depth_m / truth_m - 1)[known] <= _RIGHT
        told = f"health {estimate.health.value:.2f}, {100 * known.mean():.0f} % published"
        if known.any():
            told += f", {100 * right.mean():.0f} % right"
        print(f"{name}: {told}")
        picture = titled(told, depth_picture(depth_m, *ends_m, "m"))
        columns.append((name, [as_rgb(frame, SRGB), picture]))
    half = len(columns) // 2
    picture = np.vstack([side_by_side(columns[:half]), side_by_side(columns[half:])])
    cv2.imwrite(output, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY])


def frames(scene: LayeredScene) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield name, light without noise, and true depth, m, of each frame."""
    mask, true_m, coded = scene.camera.mask, scene.depth_m(), scene.coded()
    yield "as the bank has it", coded, true_m
    yield "no mask", scene.coded(Mask.named("disc")), true_m
    yield f"JPEG, quality {_JPEG_QUALITY}", coded, true_m
    yield f"enlarged {_ENLARGED:g} times", middle(coded), middle(true_m)
    yield f"mask turned by {_TURN_DEG:g} degrees", scene.coded(turned(mask, _TURN_DEG)), true_m
    refocused = scene.refocused(scene.camera.focus_distance_m * _REFOCUS)
    yield f"focused {100 * (1 - _REFOCUS):.0f} % nearer", refocused.coded(), true_m


def middle(picture: FloatArray) -> FloatArray:
    """Middle of a picture [rows, columns], enlarged to its size."""
    height, width = picture.shape
    large = cv2.resize(picture, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    top, left = (len(large) - height) // 2, (large.shape[1] - width) // 2
    return np.asarray(large[top : top + height, left : left + width])


def compressed(frame: FloatArray) -> FloatArray:
    """Frame [rows, columns] that was stored as JPEG, and is taken for one without loss."""
    pixels = np.rint(255 * encode(frame, SRGB)).astype(np.uint8)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return np.asarray(decode(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) / 255, SRGB), np.float32)


if __name__ == "__main__":
    main()
