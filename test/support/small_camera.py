"""A small camera, its bank, and a frame of a textured wall: what the nodes are tested with."""

import numpy as np
import yaml
from scipy.signal import fftconvolve

from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, save_bank
from coded_aperture_ros.optics import Camera, load_camera, render_psf, render_psf_stack

WIDTH, HEIGHT = 128, 96
NEAR_M, FAR_M, DEPTH_M = 1.3, 4.0, 2.0
CAMERA = {
    "focal_length_px": 400.0,
    "focus_distance_m": 1.0,
    "image_width": WIDTH,
    "image_height": HEIGHT,
    "mask": {"name": "levin"},
    "mask_extent_mm": 40.0,
}


def coded_wall(camera: Camera) -> np.ndarray:
    """Return the coded frame of a wall at DEPTH_M, with a texture like that of photographs."""
    size = 256
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)) + 1 / size
    random = np.random.default_rng(1)
    white = np.fft.fft2(random.standard_normal((size, size)))
    texture = np.fft.ifft2(white / frequency**1.2).real
    texture = 0.5 + 0.15 * texture / texture.std()
    psf = render_psf(camera.mask, float(camera.blur_size_px(DEPTH_M)))
    frame = fftconvolve(texture, psf, mode="same")[64 : 64 + HEIGHT, 64 : 64 + WIDTH]
    frame += 0.001 * random.standard_normal(frame.shape)
    return np.clip(frame, 0, 1).astype(np.float32)


def write_model(folder):
    """Write the camera and a bank into a folder; return the parameters that every node needs."""
    camera_file, bank_file = folder / "camera.yaml", folder / "bank.npz"
    camera_file.write_text(yaml.safe_dump(CAMERA))
    camera = load_camera(camera_file)
    stack = render_psf_stack(camera.mask, np.linspace(*camera.blur_range_px(NEAR_M, FAR_M), 8))
    bank = learn_bank(stack, LearnConfig(window_px=32, rank=48))
    save_bank(with_optics_limits(bank), bank_file)
    return {
        "camera_file": str(camera_file),
        "bank": str(bank_file),
        "near_m": NEAR_M,
        "far_m": FAR_M,
    }
