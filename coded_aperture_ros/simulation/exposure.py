"""Electrons and noise of a frame from illuminance, exposure, lens, mask and sensor.

The chain is that of radiometry (R. W. Boyd, Radiometry and the Detection of Optical Radiation,
1983, ch. 5; EMVA Standard 1288, release 4.0, for photons, quantum efficiency and noise):

- A Lambertian surface of reflectance r under E lux has the luminance ``r E / pi``.
- Through an entrance pupil of area A, a pixel of pitch p at the image distance d gets
  ``r E / pi A (p / d)^2`` lumen. Of a mask, A is the open area, ``o M^2``; p / d is 1 / f_px. With
  the f-number of the open area this is the usual ``r E / (4 N^2) p^2``.
- White light of 400 to 700 nm has 1.1e16 photons a second in a lumen: 683 lm/W at 555 nm, 243 lm/W
  in the mean over the band, 3.7e-19 J a photon. Rounded down to 1e16.
"""

import dataclasses
import os

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.camera_file import load_sensor
from coded_aperture_ros.optics.sensor import Sensor
from coded_aperture_ros.simulation.scene import SensorModel

# Light and rate that figures of reference cameras, demo and sample are for.
REFERENCE_LUX = 300.0
REFERENCE_RATE_HZ = 20.0
# Of white: noise of a camera whose file describes no sensor.
_UNKNOWN_SENSOR_NOISE = 0.002
# Photons on a square metre in a second, of white light of one lux.
_PHOTONS_OF_LUX = 1e16
# Share of the light that lenses let pass.
_LENS = 0.85
_BITS = 12


@dataclasses.dataclass(frozen=True)
class Exposure:
    """Illuminance, exposure, and the electrons of a pixel of the frame.

    A camera exposes for less time where white would fill the pixels.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 0.45, 640, 480, Mask.named("disc"), 10.0)
    >>> exposure = Exposure(10.0, 20.0, full_well=100_000.0, read_noise=3.0)
    >>> round(exposure.electrons(camera), -2)
    25500.0
    >>> dark, gain = exposure.noise(camera)
    >>> f"{dark:.6f} {gain:.6f}"
    '0.000137 0.000039'
    """

    illuminance_lux: float
    exposure_ms: float
    full_well: float  # electrons
    read_noise: float  # electrons
    quantum_efficiency: float = 0.6

    @staticmethod
    def with_sensor(sensor: Sensor, illuminance_lux: float, exposure_ms: float) -> "Exposure":
        """Exposure of the binned pixels of a sensor."""
        return Exposure(
            illuminance_lux,
            exposure_ms,
            sensor.frame_full_well,
            sensor.frame_read_noise,
            sensor.quantum_efficiency,
        )

    def electrons(self, camera: Camera) -> float:
        """Electrons of a white surface in a pixel, at most a full well.

        ``eta T E t o M^2 / (pi f_px^2)``: a pixel's area over the square of the image distance
        needs no pixel pitch.
        """
        area_m2 = camera.mask.open_fraction * (1e-3 * camera.mask_extent_mm) ** 2
        passed = _LENS * self.illuminance_lux * area_m2 / (np.pi * camera.focal_length_px**2)
        made = self.quantum_efficiency * _PHOTONS_OF_LUX * passed * 1e-3 * self.exposure_ms
        return float(min(made, self.full_well))

    def noise(self, camera: Camera) -> tuple[float, float]:
        """Standard deviation in the dark, and variance per unit of light, where white is 1.

        They are `noise` and `noise_gain` of a camera file.
        """
        white = self.electrons(camera)
        steps = 2.0**_BITS - 1
        return float(np.sqrt((self.read_noise / white) ** 2 + 1 / (12 * steps**2))), 1 / white

    def exposed(self, light: FloatArray, camera: Camera, random: np.random.Generator) -> FloatArray:
        """Frame, with shot and read noise, white at 1 and in 12 bits."""
        white = self.electrons(camera)
        counted = random.poisson(np.clip(light, 0, None) * white)
        noise = random.normal(0, self.read_noise, counted.shape)
        return SensorModel(bits=_BITS).expose((counted + noise) / white, random)


def sensor_of_camera_file(
    path: str | os.PathLike[str], camera: Camera, bits: int = 0
) -> SensorModel:
    """Noise of a camera file's sensor at 300 lux and 20 Hz; 0.002 of white if it has none.

    Parameters
    ----------
    path : str or path-like
        The camera file.
    camera : Camera
        What it describes.
    bits : int, optional
        See `SensorModel`.
    """
    sensor = load_sensor(path)
    if sensor is None:
        return SensorModel(_UNKNOWN_SENSOR_NOISE, bits)
    exposure = Exposure.with_sensor(sensor, REFERENCE_LUX, 1e3 / REFERENCE_RATE_HZ)
    dark, gain = exposure.noise(camera)
    return SensorModel(dark, bits, gain)
