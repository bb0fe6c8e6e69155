"""Depth from one coded frame through a simple mask."""

import dataclasses
from typing import cast

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood import Engine
from coded_aperture_ros.methods.two_pixel.engine import SimpleEngine
from coded_aperture_ros.methods.two_pixel.model import NeighbourModel
from coded_aperture_ros.optics import Camera

# A square window counts its rim as much as its middle, and widens foregrounds by this much more
# than the Hann window that `DepthConfig.rim` is made for. On two planes (blur 10 and 14 or 22 px,
# noise 0.001) the error within 16 px of the edge halves, from 5.2 to 2.6 levels.
_RIM = 1.8


class SimpleEstimator(DepthEstimator):
    """Turns coded frames into depth by a pixel and its neighbours (thesis chapter 5).

    All but the energies is that of `DepthEstimator`: frames, noise, regularisation (eq. 5.22 and
    5.24), video, confidence and metric depth.

    Parameters
    ----------
    model : NeighbourModel
    config : DepthConfig, optional
        Its `backend` does not matter: the processor computes the energies.
    camera : Camera, optional
        Turns blur sizes into metres.

    Raises
    ------
    InputError
        If the model is not for the camera.
    """

    def __init__(
        self,
        model: NeighbourModel,
        config: DepthConfig | None = None,
        camera: Camera | None = None,
    ) -> None:
        # A model has all that an estimator reads of a bank; only the engine reads more.
        config = config or DepthConfig()
        config = dataclasses.replace(config, rim=min(_RIM * config.rim, 1.0))
        super().__init__(cast(FilterBank, model), config, camera)
        self.model = model

    def _new_engine(self, shape: tuple[int, ...], stride_px: int) -> Engine:
        """Return what computes the energies of frames of a size."""
        return SimpleEngine(self.model, shape, stride_px, self.config.threads)
