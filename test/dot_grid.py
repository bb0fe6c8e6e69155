"""Photographs of a grid of dots through a coded aperture, simulated without the package's PSFs."""

import numpy as np


def point_image(transmission, blur_size_px, down, right, width):
    """What `width` pixels a side record of a point at (down, right) px off the middle one.

    The mask's extent is centred on the point; values are the light of each pixel, sum 1.
    """
    cells = np.asarray(transmission, np.float64)
    if blur_size_px < 0:
        cells = cells[::-1, ::-1]
    cell_px = abs(blur_size_px) / max(cells.shape)

    def shares(count, offset):
        pixels = np.arange(width + 1) - width / 2
        edges = (np.arange(count + 1) - count / 2) * cell_px + offset
        # How much of the line left of each edge a pixel's left part covers, differenced twice.
        upto = np.minimum(pixels[:, None], edges[None, :])
        return np.diff(np.diff(upto, axis=0), axis=1)

    image = shares(cells.shape[0], down) @ cells @ shares(cells.shape[1], right).T
    return image / image.sum()


def dot_picture(
    transmission,
    blur_size_px,
    *,
    size=(480, 640),
    spacing_px=44.3,
    peak=0.5,
    noise=0.002,
    jitter_px=0.3,
    vignetting=0.3,
    background=0.04,
    gradient=0.02,
    angle_deg=1.7,
    dark_on_bright=False,
    missing=(),
    seed=0,
):
    """Return a picture [rows, columns]; `missing` are the numbers of dots that are not there.

    `peak` is the light of a dot's brightest pixel, `jitter_px` the standard deviation of how far
    dots lie off the grid, `gradient` how much the background grows from left to right.
    """
    random = np.random.default_rng(seed)
    height, width = size
    rows, columns = np.mgrid[:height, :width]
    turn = np.deg2rad(angle_deg)
    axis = spacing_px * np.array([np.cos(turn), np.sin(turn)])
    reach = int(np.hypot(height, width) / spacing_px) + 2
    steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    down = height / 2 + 0.37 + steps[0] * axis[0] + steps[1] * axis[1]
    right = width / 2 - 0.21 - steps[0] * axis[1] + steps[1] * axis[0]
    window = 2 * int(abs(blur_size_px) / 2 + 3) + 1
    half = window // 2
    brightest = point_image(transmission, blur_size_px, 0, 0, window).max()
    inside = (down > -half) & (down < height + half) & (right > -half) & (right < width + half)
    points = np.stack([down, right], axis=1)[inside]
    points += jitter_px * random.standard_normal(points.shape)
    light = np.zeros((height + 4 * half, width + 4 * half))
    for number, (y, x) in enumerate(points):
        if number in missing:
            continue
        row, column = round(y), round(x)
        patch = point_image(transmission, blur_size_px, y - row, x - column, window)
        top, left = row + half, column + half
        light[top : top + window, left : left + window] += patch * (peak / brightest)
    light = light[2 * half : 2 * half + height, 2 * half : 2 * half + width]
    across = np.hypot((rows - height / 2) / height, (columns - width / 2) / width) / np.hypot(
        0.5, 0.5
    )
    if dark_on_bright:
        scene = 0.7 * (1 - light)
    else:
        scene = light + background
    scene = scene * (1 - vignetting * across**2) + gradient * (columns / width - 0.5)
    scene = scene + noise * random.standard_normal(scene.shape)
    return scene.astype(np.float32)
