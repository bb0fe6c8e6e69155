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
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.images import read_depth, read_image
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation import render_coded_frame

SCENES = ("desk", "corridor")
MASKS = ("levin", "four_hole", "disk")
# The pictures store 65520 for 1.0, depth is in tenths of a millimetre.
FULL_SCALE = 65535 / 65520
DEPTH_UNIT_M = 1e-4
EDGE_JUMP_PX = 1.0
EDGE_REACH_PX = 16


def load(folder: Path, mask_name: str) -> tuple[NDArray, NDArray, NDArray, Camera]:
    """Return the all-in-focus picture, the depth in metres, the coded picture and the camera."""
    meta = json.loads((folder / "meta.json").read_text())
    camera = Camera(
        focal_length_px=meta["fx"],
        focus_distance_m=meta["focus_distance_m"],
        image_width=meta["width"],
        image_height=meta["height"],
        mask=Mask.from_rows(meta["masks"][mask_name], mask_name),
        mask_extent_mm=meta["aperture_width_m"] * 1e3,
    )
    return (
        read_image(folder / "aif_linear.png") * np.float32(FULL_SCALE),
        read_depth(folder / "depth_0.1mm.png", DEPTH_UNIT_M),
        read_image(folder / f"coded_{mask_name}_linear.png") * np.float32(FULL_SCALE),
        camera,
    )


def regions(depth_m: NDArray, camera: Camera) -> dict[str, NDArray[np.bool_]]:
    """Split the image into what is away from depth edges, near them, and at the border.

    The ray-traced pictures know what lies beyond the border, the simulator does not.
    """
    size = camera.blur_size_px(depth_m)
    jump = ndimage.maximum_filter(size, 3) - ndimage.minimum_filter(size, 3) > EDGE_JUMP_PX
    near = ndimage.distance_transform_edt(~jump) <= EDGE_REACH_PX
    inside = np.zeros(size.shape, dtype=bool)
    inside[EDGE_REACH_PX:-EDGE_REACH_PX, EDGE_REACH_PX:-EDGE_REACH_PX] = True
    return {
        "all": np.ones(size.shape, dtype=bool),
        "away": inside & ~near,
        "near_edges": inside & near,
        "border": ~inside,
    }


def rmse(one: NDArray, other: NDArray, where: NDArray[np.bool_]) -> float:
    """Root mean square difference over the pixels of a region."""
    return float(np.sqrt(np.mean((one[where] - other[where]) ** 2)))


def measure(folder: Path, mask_name: str, blocks: int) -> dict[str, Any]:
    """Measure one scene with one mask."""
    sharp, depth_m, coded, camera = load(folder, mask_name)
    start = time.perf_counter()
    rendered = render_coded_frame(sharp, depth_m, camera, aperture_blocks=blocks)
    seconds = time.perf_counter() - start
    errors = {
        name: rmse(rendered, coded, where) for name, where in regions(depth_m, camera).items()
    }
    return {
        "scene": folder.name,
        "mask": mask_name,
        **{name: round(value, 5) for name, value in errors.items()},
        "sharp": round(rmse(sharp, coded, np.ones(depth_m.shape, dtype=bool)), 5),
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
