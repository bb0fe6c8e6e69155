"""Ray-traced scenes on disk: coded and all-in-focus picture, true depth and the camera."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_depth, read_image
from coded_aperture_ros.metrics.edges import edge_distance_px
from coded_aperture_ros.optics import Camera, Mask

_META = "meta.json"
# The stills' pictures store 65520 for 1.0, depth is in tenths of a millimetre.
_FULL_SCALE = np.float32(65535 / 65520)
_DEPTH_UNIT_M = 1e-4
# Where it is less than this, the depth is not reliable.
_VALID = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Rods:
    """Rods of known widths.

    Attributes
    ----------
    labels : ndarray, int32 [rows, columns]
        1 where the first is seen, and so on; 0 where none is.
    widths_px : tuple of float
    """

    labels: NDArray[np.int32]
    widths_px: tuple[float, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class RayTracedScene:
    """A scene with its truth.

    Attributes
    ----------
    coded, sharp : ndarray, float32 [rows, columns, 3]
        Linear light: as the coded camera sees it, and all in focus. Without sensor noise.
    depth_m : ndarray, float32 [rows, columns]
        NaN where unknown.
    rods : Rods or None
        Where it is known which there are.
    """

    coded: NDArray[np.float32]
    sharp: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    camera: Camera
    rods: Rods | None = None

    @classmethod
    def load(cls, folder: Path, mask_name: str) -> "RayTracedScene":
        """Read a scene folder: `meta.json`, `aif_linear.png`, `depth_0.1mm.png`, coded pictures."""
        sharp, depth_m = load_sharp(folder)
        return cls(
            coded=read_image(folder / f"coded_{mask_name}_linear.png", 1.0) * _FULL_SCALE,
            sharp=sharp,
            depth_m=depth_m,
            camera=scene_camera(folder, mask_name),
        )

    @classmethod
    def load_views(cls, folder: Path, mask_name: str, most: int) -> "list[RayTracedScene]":
        """Read a still, or at most so many frames, spread over it, of a video's folder.

        A video's folder has `meta.json` with the number of `frames`, and `aif_NNN.png`,
        `depth_NNN.png` and coded pictures.
        """
        camera = scene_camera(folder, mask_name)  # first: it checks what the folder says
        frames = scene_meta(folder).get("frames")
        if frames is None:
            return [cls.load(folder, mask_name)]
        numbers = np.unique(np.linspace(0, frames - 1, most).round().astype(int))
        return [
            cls(
                coded=read_image(folder / f"coded_{mask_name}_{number:03d}.png", 1.0),
                sharp=read_image(folder / f"aif_{number:03d}.png", SRGB),
                depth_m=read_depth(folder / f"depth_{number:03d}.png", _DEPTH_UNIT_M),
                camera=camera,
            )
            for number in numbers
        ]

    def edge_distance_px(self) -> NDArray[np.float64]:
        """Return every pixel's distance from the nearest depth edge; infinite without one.

        A depth edge is a jump of more than one pixel in blur size between neighbours. Borders of
        unknown depth are none.
        """
        return edge_distance_px(self.camera.blur_size_px(self.depth_m))


def load_sharp(folder: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read a still's sharp picture and its depth, for cameras other than that of the scene.

    Returns
    -------
    sharp : ndarray, float32 [rows, columns, 3]
        Linear light.
    depth_m : ndarray, float32 [rows, columns]
        NaN where unknown or, says `valid.png` if there is one, not reliable.
    """
    depth_m = read_depth(folder / "depth_0.1mm.png", _DEPTH_UNIT_M)
    valid = folder / "valid.png"
    if valid.exists():
        depth_m[read_image(valid, 1.0) < _VALID] = np.nan
    return read_image(folder / "aif_linear.png", 1.0) * _FULL_SCALE, depth_m


def scene_camera(folder: Path, mask_name: str) -> Camera:
    """Read from a scene's folder the camera that it was rendered with.

    Folders of ideal thin lenses say no focal length in mm; a real lens has one, and is doubted away
    from the axis as long as it is not measured.
    """
    meta = scene_meta(folder)
    try:
        rows = meta["masks"].get(mask_name)
        if rows is None:
            raise InputError(
                f"{folder}: not rendered with mask {mask_name}: use {', '.join(meta['masks'])}"
            )
        return Camera(
            focal_length_px=meta["fx"],
            focus_distance_m=meta["focus_distance_m"],
            image_width=meta["width"],
            image_height=meta["height"],
            mask=Mask.from_rows(rows, mask_name),
            mask_extent_mm=meta["aperture_width_m"] * 1e3,
            focal_length_mm=meta.get("focal_length_mm"),
        )
    except KeyError as error:
        raise InputError(f"{folder / _META}: has no {error.args[0]}") from error
    except (TypeError, AttributeError) as error:
        raise InputError(f"{folder / _META}: expected an object with objects: {error}") from error


def scene_meta(folder: Path) -> dict[str, Any]:
    """Read what a scene's folder says of itself; an `InputError` if it says nothing."""
    try:
        meta: dict[str, Any] = json.loads((folder / _META).read_text())
    except OSError as error:
        raise InputError(f"{folder}: not a ray-traced scene, no {_META}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{folder / _META}: not JSON: {error}") from error
    return meta
