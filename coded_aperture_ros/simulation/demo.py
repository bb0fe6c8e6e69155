"""The scene of demo, sample and examples, before the camera of the demo."""

from coded_aperture_ros.core.share import demo_camera_file
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.simulation.exposure import sensor_of_camera_file
from coded_aperture_ros.simulation.scene import PanningScene, motorcycle_scene


def demo_scene(period_s: float = 12.0, bits: int = 0) -> PanningScene:
    """Moving scene that the demo's camera sees, with its truth.

    A 25 mm f/1.4 lens with a mask before a model of a motorcycle, 0.64 to 1.52 m away, in 300 lux.
    Needs scikit-image, which has the photograph.

    Parameters
    ----------
    period_s : float, optional
        See `PanningScene`.
    bits : {0, 8, 12, 16}, optional
        Of the sensor; 0: no quantisation.

    Returns
    -------
    PanningScene
        With the `camera`.

    Examples
    --------
    >>> view = demo_scene().frame(0.0)
    >>> view.coded.shape, view.depth_m.shape
    ((480, 640, 3), (480, 640))
    """
    path = demo_camera_file()
    camera = load_camera(path)
    sensor = sensor_of_camera_file(path, camera, bits)
    return PanningScene(motorcycle_scene(), camera, sensor, period_s)
