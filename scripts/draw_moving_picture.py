"""Make the moving picture of the README, and the numbers below it: a camera pans over a scene.

python scripts/draw_moving_picture.py docs/images/demo.webp
"""

import sys

import cv2
import numpy as np
from PIL import Image

from coded_aperture_ros import FramePipeline
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io.depth_picture import depth_picture
from coded_aperture_ros.io.panels import panels
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.metrics.errors import psnr_db
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M, demo_scene
from coded_aperture_ros.simulation.scene import SimulatedFrame

NEAR_M, FAR_M = MOTORCYCLE_RANGE_M
FRAMES, PERIOD_S, WIDTH = 16, 12.0, 320


def shown(light: np.ndarray) -> np.ndarray:
    """Return linear light as a small picture."""
    return small(pixels_from_linear(np.clip(light, 0, 1), 8, SRGB))


def small(picture: np.ndarray) -> np.ndarray:
    """Return a picture at the width of a panel."""
    height = round(picture.shape[0] * WIDTH / picture.shape[1])
    return cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)


def measured(view: SimulatedFrame, depth_m: np.ndarray, sharp: np.ndarray) -> tuple[float, ...]:
    """Share published, median error, share of it within 10 %; PSNR coded and all in focus, dB."""
    known = np.isfinite(depth_m)
    error = np.abs(depth_m - view.depth_m)[known] / view.depth_m[known]
    right = float((error <= 0.1).mean())
    gain = psnr_db(view.coded, view.sharp), psnr_db(sharp, view.sharp)
    return (float(known.mean()), float(np.median(error)), right, *gain)


def main() -> None:
    """Process the frames in their order, as the nodes do, and write one picture of all."""
    scene = demo_scene(PERIOD_S)
    camera = scene.camera
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M)
    pipeline = FramePipeline(bank, camera, DepthConfig(temporal_frames=4.0))
    pictures, figures = [], []
    for index in range(FRAMES):
        view = scene.frame(index * PERIOD_S / FRAMES)
        estimate = pipeline(view.coded)
        sharp = pipeline.deblur(view.coded, estimate)
        figures.append(measured(view, estimate.depth_m, sharp))
        rows = [
            [
                ("coded frame", shown(view.coded)),
                ("depth (hatched: unknown)", small(depth_picture(estimate.depth_m, NEAR_M, FAR_M))),
            ],
            [
                ("all in focus", shown(sharp)),
                ("true depth", small(depth_picture(view.depth_m, NEAR_M, FAR_M))),
            ],
        ]
        pictures.append(Image.fromarray(panels(rows)))
    pipeline.close()
    published, error, right, coded_db, sharp_db = np.mean(figures, axis=0)
    sys.stdout.write(
        f"depth at {published:.0%} of the pixels, median error {error:.1%}, {right:.0%} within "
        f"10 %; {coded_db:.1f} dB coded, {sharp_db:.1f} dB all in focus ({FRAMES} frames)\n"
    )
    first, *others = pictures
    first.save(
        sys.argv[1],
        save_all=True,
        append_images=others,
        duration=round(1000 * PERIOD_S / FRAMES / 2),
        loop=0,
        quality=60,
        method=6,
    )


if __name__ == "__main__":
    main()
