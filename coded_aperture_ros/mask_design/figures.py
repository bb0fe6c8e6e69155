"""Figures of masks. Needs matplotlib, which is imported only when drawing."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.figures import PathLike, new_panels, save_figure
from coded_aperture_ros.mask_design.fragmentation import Fragmentation, transfer
from coded_aperture_ros.optics import render_psf

# Extent of the masks whose frequency responses are drawn.
_SLICE_SIZE_PX = 16.0


def fragmentation(
    analysis: Fragmentation, ranges: Sequence[tuple[float, float]], path: PathLike
) -> None:
    """Draw slices of the frequency responses of the best masks and of the disc (thesis fig. 7.2).

    There is a row for each range of the noise, with the mask that is the best for it, its response
    along a row of frequencies, the disc's, and the noise.
    """
    figure, panels = new_panels(len(ranges), 2, width=1.2)
    for (low, high), (picture, axes) in zip(ranges, panels, strict=True):
        mask = analysis.masks[analysis.best(low, high)]
        picture.imshow(mask.transmission, cmap="gray", vmin=0, vmax=1)
        picture.set_axis_off()
        picture.set_title(f"best for noise {low:g} to {high:g}", fontsize=9)
        for shown, style, label in ((analysis.disc, "r--", "disc"), (mask, "b-", "fragmented")):
            response = transfer(render_psf(shown, _SLICE_SIZE_PX))[0]
            axes.semilogy(np.linspace(0, 0.5, len(response)), response, style, label=label)
        axes.axhline(high, color="g", linewidth=1, label="noise")
        axes.set_ylim(1e-3, 1.1)
        axes.set_xlabel("horizontal frequency, cycles/px", fontsize=8)
        axes.set_title(f"response, blur of {_SLICE_SIZE_PX:g} px", fontsize=9)
    panels[0][1].legend(fontsize=7)
    save_figure(figure, path)


def distance_matrices(matrices: Mapping[str, NDArray[np.floating]], path: PathLike) -> None:
    """Draw distances between the subspaces of levels (thesis figure 9.5); bright is far.

    `matrices` has titles, and distances [L, L] as shares of the largest possible, 0 to 1.
    """
    columns = min(len(matrices), 5)
    rows = -(-len(matrices) // columns)
    figure, panels = new_panels(rows, columns)
    for axes in panels.flat:
        axes.set_axis_off()
    for axes, (title, matrix) in zip(panels.flat, matrices.items(), strict=False):
        axes.imshow(matrix, cmap="gray", vmin=0, vmax=1)
        axes.set_title(title, fontsize="small")
    save_figure(figure, path)
