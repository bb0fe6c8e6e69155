"""Scene of layers in front of a camera: coded frame and ground truth."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.simulation.layered.tracing import (
    FEWEST_CELLS,
    Layer,
    lens_samples,
    seen_from_centre,
    traced,
)


@dataclasses.dataclass(frozen=True, eq=False)
class LayeredScene:
    """A scene of layers, nearest first, before a camera.

    Attributes
    ----------
    layers : tuple of Layer
        The last ones fill the frame.
    camera : Camera
        Its mask, and blur sizes as of the layers; image size as of the frame.

    Examples
    --------
    See `random_scene`.
    """

    layers: tuple[Layer, ...]
    camera: Camera

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.camera.image_height, self.camera.image_width

    def coded(self, mask: Mask | None = None, fewest_cells: int = FEWEST_CELLS) -> FloatArray:
        """Frame that the camera records, without noise, float32 [rows, columns].

        Another `mask` may stand in for the camera's; see `lens_samples` for `fewest_cells`.
        """
        samples = lens_samples(mask or self.camera.mask, self._widest_px(), fewest_cells)
        return traced(list(self.layers), self.shape, samples)

    def all_in_focus(self) -> FloatArray:
        """Frame through the middle of the aperture alone, float32 [rows, columns]."""
        return traced(list(self.layers), self.shape, np.array([[0, 0, 1]], np.float32))

    def blur_size_px(self) -> FloatArray:
        """Signed blur size of what every pixel shows, float32 [rows, columns]."""
        return seen_from_centre(list(self.layers), self.shape)

    def depth_m(self) -> FloatArray:
        """Depth of what every pixel shows, float32 [rows, columns]."""
        return np.asarray(self.camera.depth_m(self.blur_size_px()), np.float32)

    def refocused(self, focus_m: float) -> "LayeredScene":
        """Scene before the same lens, focused at another distance without breathing.

        Blur sizes are linear in the inverse of the depth, whatever the focus.
        """
        camera = dataclasses.replace(self.camera, focus_distance_m=focus_m, side="both")
        more = camera.blur_at_infinity_px - self.camera.blur_at_infinity_px
        layers = (
            dataclasses.replace(layer, blur_px=(layer.blur_px[0] + more, *layer.blur_px[1:]))
            for layer in self.layers
        )
        return LayeredScene(tuple(layers), camera)

    def _widest_px(self) -> float:
        return float(np.nanmax(np.abs(self.blur_size_px())))
