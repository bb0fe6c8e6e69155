"""Interactive page of a design, which computes the formulas of `setting` itself."""

import dataclasses
import json
import os
from importlib.resources import files
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.page_style import with_style
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.design.setting import DesignConfig, Setting
from coded_aperture_ros.optics import Camera

# Where the template has the values that the page starts from.
_PLACEHOLDER = "/*DESIGN*/ null"


def write_page(
    camera: Camera,
    near_m: float,
    far_m: float,
    best: list[Setting],
    config: DesignConfig,
    focus_range_m: tuple[float, float],
    extent_range_mm: tuple[float, float],
    path: str | os.PathLike[str],
) -> None:
    """Write a page with sliders for focus, mask extent and depth range (HTML, self-contained).

    The sliders start from the camera and the depth range, end at the other ranges, and go to the
    `best` settings on demand; after the page's address, `#focus=1.5&extent=12&near=2&far=5` sets
    them.
    """
    values = {
        "focus_m": camera.focus_distance_m,
        "extent_mm": camera.mask_extent_mm,
        "near_m": near_m,
        "far_m": far_m,
        "focus_range_m": focus_range_m,
        "extent_range_mm": extent_range_mm,
        "depth_range_m": [near_m / 4, far_m * 4],
        "focal_length_mm": camera.focal_length_mm,
        "focal_length_px": camera.focal_length_px,
        "lens_mask_distance_mm": camera.lens_mask_distance_mm,
        "image_px": [camera.image_width, camera.image_height],
        "mask": camera.mask.name,
        "hole_share": mask_openings(camera.mask).smallest_width,
        "open_fraction": camera.mask.open_fraction,
        "resolution_px": config.resolution_px,
        "wavelength_nm": config.wavelength_nm or camera.wavelength_nm,
        "best": [dataclasses.asdict(setting) for setting in best],
    }
    template = files("coded_aperture_ros.design").joinpath("page.html").read_text(encoding="utf-8")
    # The name of a mask file may have anything in it; "</script>" would end the script.
    script = json.dumps(finite(values), allow_nan=False).replace("<", "\\u003c")
    page = with_style(template).replace(_PLACEHOLDER, script)
    Path(path).write_text(page, encoding="utf-8")


def finite(value: Any) -> Any:
    """Structure of dicts and lists with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
