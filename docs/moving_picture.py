"""Make the moving picture of the README: a simulated camera pans over a scene.

python docs/moving_picture.py docs/images/demo.webp
"""

import sys

import cv2
import numpy as np
from PIL import Image

from coded_aperture_ros import FramePipeline
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io.depth_picture import depth_picture
from coded_aperture_ros.io.panels import panels
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M, PanningScene, motorcycle_scene
from coded_aperture_ros.simulation.exposure import sensor_of_camera_file

NEAR_M, FAR_M = MOTORCYCLE_RANGE_M
FRAMES, PERIOD_S, WIDTH = 16, 12.0, 320


def shown(light: np.ndarray) -> np.ndarray:
    """Return linear light as a small picture."""
    return small(pixels_from_linear(np.clip(light, 0, 1), 8, SRGB))


def small(picture: np.ndarray) -> np.ndarray:
    """Return a picture at the width of a panel."""
    height = round(picture.shape[0] * WIDTH / picture.shape[1])
    return cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)


def main() -> None:
    """Process the frames in their order, as the nodes do, and write one picture of all."""
    path = share_directory() / "config" / "demo_camera.yaml"
    camera = load_camera(path)
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M, 30)
    scene = PanningScene(motorcycle_scene(), camera, sensor_of_camera_file(path, camera), PERIOD_S)
    pipeline = FramePipeline(bank, camera, DepthConfig(temporal_frames=4.0))
    pictures = []
    for index in range(FRAMES):
        view = scene.frame(index * PERIOD_S / FRAMES)
        estimate = pipeline(view.coded)
        sharp = pipeline.deblur(view.coded, estimate)
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
