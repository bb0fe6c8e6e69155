"""How much lenses for photography defocus away from the axis: `SPREAD` of `optics/field_prior`.

    python training/field_prior.py lens.zmx ...

Traces what optiland has of published lenses, and prescriptions in files (Zemax, or tables as
`calibrate trace` reads them), and prints radial and tangential defocus times the focal length over
the squared tangent of the field angle. Needs optiland.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from optiland.samples import objectives

from coded_aperture_ros.calibration.prescription.lens import Lens, load_lens

# Published designs for photography that optiland has: Cooke triplet, double Gauss, ... .
_SAMPLES = (
    "CookeTriplet",
    "DoubleGauss",
    "ReverseTelephoto",
    "ObjectiveUS008879901",
    "HeliarLens",
    "TessarLens",
    "PetzvalLens",
    "Telephoto",
    "WideAngle100FOV",
)
_TANGENTS = (0.1, 0.2, 0.3)
# F-number that a mask leaves of a faster lens; distances of the object, in focal lengths.
_F_NUMBER = 2.8
_FOCUS, _BEYOND = 40.0, 50.0
_WAVELENGTH_UM = 0.55
_FEWEST_RAYS = 20
# Farther from the axis than its designer meant, a lens has no picture.
_LARGEST = 0.5


def _sample(name: str) -> Lens:
    optic = getattr(objectives, name)()
    optic.wavelengths.wavelengths.clear()
    optic.wavelengths.add(value=_WAVELENGTH_UM, is_primary=True)
    surfaces = optic.surfaces.num_surfaces - 2
    return Lens(optic, (np.inf,) * surfaces, optic.surfaces.stop_index)


def _spread(lens: Lens, depth_m: float, tangent: float, points_mm: np.ndarray) -> np.ndarray:
    """Growth of the blur with the aperture, across and along the field [2]; NaN without rays."""
    rays = lens.trace(depth_m, tangent, points_mm)
    if rays.passed.sum() < _FEWEST_RAYS:
        return np.full(2, np.nan)
    points = np.vstack([points_mm, np.ones(points_mm.shape[1])])[:, rays.passed]
    return np.diag(np.linalg.lstsq(points.T, rays.sensor[:, rays.passed].T, rcond=None)[0])


def defocus(lens: Lens) -> np.ndarray:
    """Defocus times focal length over squared tangent, across and along the field [tangents, 2]."""
    focal_m = lens.focal_length_mm * 1e-3
    f_number = max(_F_NUMBER, float(lens.optic.paraxial.FNO()))
    along = np.linspace(-0.45, 0.45, 9) * lens.focal_length_mm / f_number
    points_mm = np.stack(np.meshgrid(along, along)).reshape(2, -1)
    points_mm = points_mm[:, np.hypot(*points_mm) <= along[-1]]
    lens.focused(_FOCUS * focal_m, 0.8 * points_mm)
    on_axis, beyond = (_spread(lens, d * focal_m, 0.0, points_mm) for d in (_FOCUS, _BEYOND))
    per_dioptre = (beyond - on_axis) / (1 / _FOCUS - 1 / _BEYOND) * focal_m
    found = [
        (on_axis - _spread(lens, _FOCUS * focal_m, tangent, points_mm))
        / per_dioptre
        * focal_m
        / tangent**2
        for tangent in _TANGENTS
    ]
    return -np.array(found)


def main() -> None:
    """Print a line for each lens, and the root mean square over all."""
    warnings.simplefilter("ignore")
    lenses = {name: _sample(name) for name in _SAMPLES}
    lenses |= {Path(f).stem: load_lens(Path(f), _WAVELENGTH_UM * 1e3) for f in sys.argv[1:]}
    every = []
    for name, lens in lenses.items():
        found = defocus(lens)
        found[np.abs(found) > _LARGEST] = np.nan
        every.append(found)
        print(f"{name:24}", *(f"{a:+.3f} {b:+.3f}" for a, b in found), sep="  ")
    squares = np.nanmean(np.square(every), axis=(1, 2))
    print(f"{len(every)} lenses, root mean square {np.sqrt(np.mean(squares)):.3f}")
    print(f"mean {np.nanmean(every):+.3f}")


if __name__ == "__main__":
    main()
