"""Planes behind a mask that is not symmetric, and a folder of them."""

import json

import numpy as np
from planes_scene import texture
from scipy.signal import fftconvolve

from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import Mask, render_psf

WINDOW, NOISE = 24, 0.001
FOCUS_M, LARGEST_PX = 1.0, 11.0
MASK = Mask.named("veeraraghavan")  # not symmetric
DEPTHS_M = 1 / np.linspace(0.85, 0.25, 7)


def blur_size_px(depth_m):
    return LARGEST_PX * (1 - FOCUS_M / depth_m) / (1 - FOCUS_M / DEPTHS_M[-1])


def plane(depth_m, seed, size=144):
    """Photograph of a plane."""
    random = np.random.default_rng(seed)
    blurred = fftconvolve(texture(random, size), render_psf(MASK, blur_size_px(depth_m)), "same")
    blurred = 0.45 + 0.07 * blurred[:size, :size]
    return (blurred + random.normal(0, NOISE, blurred.shape)).astype(np.float32)


def few_steps(monkeypatch):
    """Learn quickly: for tests of what is around the fit."""
    for name in ("_FIRST_STEPS", "_COARSE_STEPS", "_FINE_STEPS", "_SINGLE_STEPS"):
        monkeypatch.setattr(f"coded_aperture_ros.calibration.planes.search.{name}", 1)
    monkeypatch.setattr("coded_aperture_ros.calibration.mask.cells._STARTS", 4)
    # One step does not even find the side of the focus, by which the order is judged.
    monkeypatch.setattr("coded_aperture_ros.calibration.planes.order._MIN_PLANES", 99)


def folder_of(tmp_path, entries=None, **pictures):
    """Make a folder of planes; `entries` None lists six good ones, a callable changes them."""
    listed = []
    for number, depth in enumerate((1.2, 1.4, 1.7, 2.1, 2.8, 4.0)):
        name = f"plane_{number}.png"
        image = pictures.get(f"plane_{number}", plane(depth, number, 48))
        write_image(tmp_path / name, image)
        listed.append({"file": name, "depth_m": depth})
    if entries is not None:
        listed = entries(listed)
    text = listed if isinstance(listed, str) else json.dumps(listed)
    (tmp_path / "planes.json").write_text(text)
    return tmp_path
