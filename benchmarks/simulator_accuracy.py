"""RMSE of the simulator against ray-traced coded photographs with exact occlusion.

Each ray-traced scene comes with its all-in-focus picture and depth map. Both go into
`render_coded_frame`; the result is compared with the ray-traced coded picture.
"""

import itertools
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.scripts import data_folder, data_parser, exit_status, print_rows
from numpy.typing import NDArray

from coded_aperture_ros.simulation import render_coded_frame

SCENES = ("desk", "corridor")
MASKS = ("levin", "four_hole", "disk")
EDGE_REACH_PX = 16


def regions(scene: RayTracedScene) -> dict[str, NDArray[np.bool_]]:
    """Split the image into what is away from depth edges, near them, and at the border.

    The ray-traced pictures know what lies beyond the border, the simulator does not.
    """
    near = scene.edge_distance_px() <= EDGE_REACH_PX
    inside = np.zeros(near.shape, dtype=bool)
    inside[EDGE_REACH_PX:-EDGE_REACH_PX, EDGE_REACH_PX:-EDGE_REACH_PX] = True
    return {
        "all": np.ones(near.shape, dtype=bool),
        "away": inside & ~near,
        "near_edges": inside & near,
        "border": ~inside,
    }


def rmse(one: NDArray, other: NDArray, where: NDArray[np.bool_]) -> float:
    """Root mean square difference over the pixels of a region."""
    return float(np.sqrt(np.mean((one[where] - other[where]) ** 2)))


def measure(folder: Path, mask_name: str, blocks: int) -> dict[str, Any]:
    """Measure one scene with one mask."""
    scene = RayTracedScene.load(folder, mask_name)
    start = time.perf_counter()
    rendered = render_coded_frame(scene.sharp, scene.depth_m, scene.camera, aperture_blocks=blocks)
    seconds = time.perf_counter() - start
    errors = {name: rmse(rendered, scene.coded, where) for name, where in regions(scene).items()}
    return {
        "scene": folder.name,
        "mask": mask_name,
        **{name: round(value, 5) for name, value in errors.items()},
        "sharp": round(rmse(scene.sharp, scene.coded, np.ones(scene.depth_m.shape, dtype=bool)), 5),
        "seconds": round(seconds, 2),
    }


def main() -> int:
    """Print the table."""
    parser = data_parser(__doc__, "rendered/")
    parser.add_argument("--blocks", type=int, default=3, help="aperture blocks (default 3)")
    args = parser.parse_args()
    folder = data_folder(parser, args) / "rendered"

    def measure_all() -> None:
        cases = itertools.product(SCENES, MASKS)
        rows = (measure(folder / scene, mask, args.blocks) for scene, mask in cases)
        print_rows(rows, args.json)

    return exit_status(measure_all)


if __name__ == "__main__":
    sys.exit(main())
