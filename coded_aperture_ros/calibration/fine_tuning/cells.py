"""Maps of frames, brought to one number of cells."""

import numpy as np

from coded_aperture_ros.depth.decoders.network.cells import CELL_PX

# Cells a side: frames of 288 px have no more, wherever the first cell lies.
CELLS = 40
# Blur sizes are kept in such steps, px.
BLUR_STEP = 1 / 1500


def padded(values: np.ndarray, side: int) -> np.ndarray:
    """Values with the last two axes padded to a common size by the outermost ones; float16."""
    margins = [(0, 0)] + [(0, side - length) for length in values.shape[-2:]]
    return np.pad(values, margins, mode="edge").astype(np.float16)


def on_all_cells(values: np.ndarray, corner: np.ndarray, fill: float) -> np.ndarray:
    """Map of a frame at every pixel of its cells, float32; filled beyond the frame."""
    whole = np.full((CELLS * CELL_PX,) * 2, fill, np.float32)
    top, left = corner
    within = whole[-top:, -left:][: values.shape[0], : values.shape[1]]
    within[:] = values[: within.shape[0], : within.shape[1]]
    return whole
