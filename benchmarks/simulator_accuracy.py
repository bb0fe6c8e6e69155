"""RMSE of the simulator against ray-traced coded photographs with exact occlusion.

Each ray-traced scene comes with its all-in-focus picture and depth map. Both go into
`render_coded_frame`; the result is compared with the ray-traced coded picture.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.frames.ray_traced import RayTracedScene
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data",
        default=os.environ.get("CODED_APERTURE_DATA"),
        help="folder that holds rendered/ (default: $CODED_APERTURE_DATA)",
    )
    parser.add_argument("--blocks", type=int, default=3, help="aperture blocks (default 3)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    args = parser.parse_args()
    if args.data is None:
        parser.error("say where the data are: --data, or set CODED_APERTURE_DATA")
    rows = []
    try:
        for scene in SCENES:
            for mask_name in MASKS:
                rows.append(measure(Path(args.data) / "rendered" / scene, mask_name, args.blocks))
                if not args.json:
                    if len(rows) == 1:
                        print("".join(f"{name:>12}" for name in rows[0]))
                    print("".join(f"{value!s:>12}" for value in rows[-1].values()), flush=True)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    if args.json:
        print(json.dumps(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
