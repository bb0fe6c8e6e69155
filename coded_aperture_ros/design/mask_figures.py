"""Figures of masks. Matplotlib is imported only when drawing."""

from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.figures import PANEL_INCHES, PathLike, new_figure, save_figure
from coded_aperture_ros.design.fragmentation import Fragmentation, transfer
from coded_aperture_ros.optics import Mask, render_psf

# Extent of the masks whose frequency responses are drawn.
_SLICE_SIZE_PX = 16.0
# Width of a panel, relative to its height.
_WIDTH = 1.2


def draw_fragmented_responses(
    analysis: Fragmentation, ranges: Sequence[tuple[float, float]], path: PathLike
) -> None:
    """Draw slices of the frequency responses of the best masks and of the disc (thesis fig. 7.2).

    There is a row for each range of the noise, with the mask that is the best for it, its response
    along a row of frequencies, the disc's, and the noise.
    """
    down = len(ranges)
    figure = new_figure(_WIDTH * PANEL_INCHES * 2, PANEL_INCHES * down)
    panels = figure.subplots(down, 2, squeeze=False)
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


def draw_masks_by_light(masks: Sequence[tuple[Mask, float, float]], path: PathLike) -> None:
    """Draw masks by their light and their depth error.

    Parameters
    ----------
    masks : sequence of (Mask, float, float)
        With the open share and the relative depth error of each.
    """
    from matplotlib.offsetbox import AnnotationBbox, OffsetImage

    figure = new_figure(2.6 * PANEL_INCHES, 1.8 * PANEL_INCHES)
    axes = figure.subplots()
    lights, errors = (np.array([each[k] for each in masks]) for k in (1, 2))
    axes.plot(lights, 100 * errors, ".", color="0.7")
    for mask, light, error in masks:
        grid = mask.transmission
        image = OffsetImage(grid, zoom=26 / max(grid.shape), cmap="gray", interpolation="nearest")
        frame = {"edgecolor": "0.4"}
        axes.add_artist(AnnotationBbox(image, (light, 100 * error), pad=0.1, bboxprops=frame))
        axes.annotate(
            mask.name,
            (light, 100 * error),
            (0, -24),
            textcoords="offset points",
            ha="center",
            fontsize=7,
        )
    # Those that no other beats in both.
    order = np.argsort(-lights)
    best = [index for index in order if errors[index] <= errors[lights >= lights[index]].min()]
    axes.step(lights[best], 100 * errors[best], where="pre", color="tab:blue", linewidth=1)
    axes.margins(0.15)
    axes.set_xlabel("open share of the mask")
    axes.set_ylabel("median depth error, %")
    save_figure(figure, path)
