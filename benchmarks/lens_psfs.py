"""How well a wavefront predicts the PSFs of a lens: fitted to dots at some distances, or traced.

The folder holds pictures of a grid of dots, `dots_1.50m.png` and so on; a scene of the same lens
says in its `meta.json` what mask and focus it has. Every PSF is compared as it lies in the picture,
with its light and its middle taken out; the error is the norm of the difference over that of the
PSF. With `--camera` nothing is fitted: the file comes from `calibrate trace`, or planes.
"""

import argparse
import re
from pathlib import Path

import numpy as np
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from numpy.typing import NDArray
from scipy.optimize import least_squares

from coded_aperture_ros.calibration.psf.lattice import find_lattice
from coded_aperture_ros.core.text import table
from coded_aperture_ros.io import read_image
from coded_aperture_ros.optics import Camera, Wavefront, load_camera
from coded_aperture_ros.optics.wavefront import TERMS

_WIDTH, _FINER = 27, 3
# Mask extent, rims, terms: first guesses and steps.
_FIRST = np.array([1.0, 1.1, 0.4, 1.1, -0.2, -0.3, 0.2, -0.15, *[0.0] * (len(TERMS) - 3)])
_STEPS = np.array([0.002, *[0.01] * 4, *[0.005] * len(TERMS)])
Dot = tuple[NDArray[np.float64], NDArray[np.float64]]


def main() -> None:
    """Fit, and print the errors of every picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dots", type=Path, help="folder with pictures of dots")
    parser.add_argument("scene", type=Path, help="folder of a ray-traced scene of the same lens")
    parser.add_argument("--fit", nargs="+", default=["1.50", "3.00"], help="distances fitted, m")
    parser.add_argument("--every", type=int, default=7, help="one dot of so many is fitted")
    parser.add_argument("--camera", type=Path, help="camera file with a wavefront")
    args = parser.parse_args()
    camera = RayTracedScene.load(args.scene, "levin").camera
    if args.camera is not None:
        camera, args.fit = load_camera(args.camera), []
    pictures = {
        found[1]: _dots(path, camera)
        for path in sorted(args.dots.glob("dots_*m.png"))
        if (found := re.search(r"_([\d.]+)m\.png", path.name))
    }
    corner = float(np.hypot(camera.image_height, camera.image_width) / 2 / camera.focal_length_px)
    fitted = [(float(z), dot) for z in args.fit for dot in pictures[z][:: args.every]]

    def wavefront(state: NDArray[np.float64]) -> Wavefront:
        values = state.tolist()
        return Wavefront(corner, tuple(values[5:]), tuple(values[1:5]))

    def left(state: NDArray[np.float64]) -> NDArray[np.float64]:
        lens = wavefront(state)
        parts = [_difference(camera, lens, state[0], z, dot) for z, dot in fitted]
        return np.concatenate(parts) / np.sqrt(len(parts))

    def slopes(state: NDArray[np.float64]) -> NDArray[np.float64]:
        ends = [(left(state + step), left(state - step)) for step in np.diag(_STEPS)]
        return np.stack([after - before for after, before in ends], axis=1) / (2 * _STEPS)

    solved, lens = _FIRST, camera.wavefront
    if args.fit:
        solved = least_squares(left, _FIRST, slopes, x_scale=_STEPS, max_nfev=25).x
        lens = wavefront(solved)
    assert lens is not None
    rows = []
    for z, dots in pictures.items():
        errors = np.array(
            [np.linalg.norm(_difference(camera, lens, solved[0], float(z), dot)) for dot in dots]
        )
        field = np.array([np.hypot(*tangent) / corner for _, tangent in dots])
        thirds = [errors[(field * 3).astype(int).clip(0, 2) == i].mean() for i in range(3)]
        size_px = float(camera.blur_size_px(float(z))) * solved[0]
        numbers = errors.mean(), *thirds, errors.max()
        what = f"one in {args.every}" if z in args.fit else "no"
        rows.append([f"{z} m", f"{size_px:.1f} px", what, *(f"{100 * n:.1f} %" for n in numbers)])
    print(lens.entry)
    print(table(["at", "blur", "fitted", "error", "inner", "middle", "outer", "worst"], rows))


def _dots(path: Path, camera: Camera) -> list[Dot]:
    """Return PSFs of unit sum, and their tangents, of the dots that lie wholly in a picture."""
    green, k = read_image(path)[..., 1].astype(np.float64), camera.intrinsics.camera_matrix
    half, dots = _WIDTH // 2, []
    for row, column in np.rint(find_lattice(green).positions).astype(int):
        window = green[
            max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1
        ]
        if window.shape == (_WIDTH, _WIDTH):
            tangent = np.array([(row - k[5]) / k[4], (column - k[2]) / k[0]])
            dots.append((window / window.sum(), tangent))
    return dots


def _difference(
    camera: Camera, lens: Wavefront, scale: float, depth_m: float, dot: Dot
) -> NDArray[np.float64]:
    """Return what a PSF, moved to where the dot is, leaves of it, over the dot's norm."""
    seen, tangent = dot
    size_px, unit = float(camera.blur_size_px(depth_m)) * scale, camera.blur_per_dioptre_px
    fine = lens.psf(
        camera.mask, size_px * _FINER, unit * _FINER, tangent, (_WIDTH + 8) * _FINER
    ).astype(np.float64)
    moved = (_middle(seen) - _middle(fine) / _FINER) * _FINER
    # By the phases of its transform: by fractions of a pixel.
    frequency = np.fft.fftfreq(len(fine))
    phases = np.exp(-2j * np.pi * (frequency[:, None] * moved[0] + frequency * moved[1]))
    shifted = np.fft.ifft2(np.fft.fft2(fine) * phases).real
    cut = (len(fine) - _WIDTH * _FINER) // 2
    inside = shifted[cut : len(fine) - cut, cut : len(fine) - cut]
    coarse = inside.reshape(_WIDTH, _FINER, _WIDTH, _FINER).sum(axis=(1, 3))
    return ((coarse / coarse.sum() - seen) / np.linalg.norm(seen)).ravel()


def _middle(light: NDArray[np.float64]) -> NDArray[np.float64]:
    places = np.indices(light.shape) - (len(light) - 1) / 2
    return (places * light).sum(axis=(1, 2)) / light.sum()


if __name__ == "__main__":
    main()
