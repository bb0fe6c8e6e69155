"""PSFs as they are measured: pictures of dots, and files of PSFs."""

from functools import cache

import numpy as np

from coded_aperture_ros.optics import Mask, render_psf, render_psf_stack


def measured_file(path, depths=None, sizes=None, levels=3):
    """PSFs as someone might measure them: not of unit sum, a little noisy."""
    stack = render_psf_stack(Mask.named("levin"), np.linspace(4, 9, levels))
    noise = 0.01 * np.random.default_rng(0).standard_normal(stack.psfs.shape)
    arrays = {"psfs": 7 * stack.psfs + noise * stack.psfs.max()}
    if depths is not None:
        arrays["depths_m"] = np.array(depths)
    if sizes is not None:
        arrays["sizes_px"] = np.array(sizes)
    np.savez(path, **arrays)
    return path


@cache
def _cells(mask):
    return Mask.named(mask).transmission.astype(float)


def point_image(mask, blur_size_px, down, right, width):
    """What `width` pixels a side record of a point at (down, right) px off the middle one.

    By differences of what lies left of each edge, apart from how the package does it.
    """
    cells = _cells(mask)
    if blur_size_px < 0:
        cells = cells[::-1, ::-1]

    def shares(count, offset):
        pixels = np.arange(width + 1) - width / 2
        edges = (np.arange(count + 1) - count / 2) * abs(blur_size_px) / max(cells.shape) + offset
        return np.diff(np.diff(np.minimum(pixels[:, None], edges[None, :]), axis=0), axis=1)

    image = shares(cells.shape[0], down) @ cells @ shares(cells.shape[1], right).T
    return image / image.sum()


def dot_picture(
    mask,
    blur_size_px,
    *,
    size=(480, 640),
    spacing_px=44.3,
    peak=0.5,
    noise=0.002,
    jitter_px=0.3,
    angle_deg=1.7,
    missing=0.0,
    seed=0,
):
    """Simulate a picture of a grid of points, vignetted, over background light that is uneven.

    `peak` is about the light of a dot's brightest pixel, `jitter_px` the standard deviation of how
    far dots lie off the grid, `missing` the share of dots that are not there.
    """
    random = np.random.default_rng(seed)
    height, width = size
    turn = np.deg2rad(angle_deg)
    basis = spacing_px * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    reach = int(np.hypot(height, width) / spacing_px) + 2
    steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
    window = 2 * int(abs(blur_size_px) / 2 + 3) + 1
    half = window // 2
    points = steps @ basis + np.array([height / 2 + 0.37, width / 2 - 0.21])
    points = points[((points > -half) & (points < np.array(size) + half)).all(axis=1)]
    points += jitter_px * random.standard_normal(points.shape)
    points = points[random.random(len(points)) >= missing]
    strength = peak / point_image(mask, blur_size_px, 0.25, 0.25, window).max()
    margin = 2 * half + 8
    light = np.zeros((height + 2 * margin, width + 2 * margin))
    for y, x in points:
        row, column = round(y), round(x)
        top, left = row + margin - half, column + margin - half
        patch = point_image(mask, blur_size_px, y - row, x - column, window)
        light[top : top + window, left : left + window] += strength * patch
    light = light[margin : margin + height, margin : margin + width]
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) for n in size), indexing="ij")
    scene = (light + 0.04) * (1 - 0.15 * (rows**2 + columns**2)) + 0.01 * columns
    return np.clip(scene + noise * random.standard_normal(size), 0, 1).astype(np.float32)


def error_of(psf, mask, blur_size_px):
    true = render_psf(Mask.named(mask), blur_size_px, len(psf))
    return np.linalg.norm(psf - true) / np.linalg.norm(true)
