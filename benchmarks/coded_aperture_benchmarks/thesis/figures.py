"""Figures of the thesis, with our numbers. Needs matplotlib."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.figures import new_panels
from coded_aperture_ros.core.figures import PANEL_INCHES, PathLike, new_figure, save_figure

# As in thesis figure 6.4.
_DEVIATIONS = 3.0
_UNKNOWN = "0.8"


def stair_spread(rows: Sequence[Mapping[str, Any]], path: PathLike) -> None:
    """Draw estimated against true level, mean and three standard deviations (thesis figure 6.4).

    Parameters
    ----------
    rows : sequence of mapping
        One for each mask, noise and method: `mask`, `sigma`, `method`, `mean_of_step` and
        `deviation_of_step`. A panel for each mask (down) and noise (across).
    """
    masks = list(dict.fromkeys(row["mask"] for row in rows))
    sigmas = list(dict.fromkeys(row["sigma"] for row in rows))
    figure, panels = new_panels(len(masks), len(sigmas))
    for mask, line in zip(masks, panels, strict=True):
        for sigma, axes in zip(sigmas, line, strict=True):
            here = [row for row in rows if (row["mask"], row["sigma"]) == (mask, sigma)]
            levels = np.arange(len(here[0]["mean_of_step"]))
            axes.plot(levels, levels, "k--", linewidth=0.8)
            for index, row in enumerate(here):
                axes.errorbar(
                    levels + 0.25 * index,  # so that bars do not hide each other
                    row["mean_of_step"],
                    _DEVIATIONS * np.asarray(row["deviation_of_step"]),
                    label=row["method"],
                    linewidth=1,
                    elinewidth=0.6,
                )
            axes.set_title(f"{mask}, sigma {sigma:g}", fontsize=9)
            axes.set_ylim(-2, len(levels) + 1)
            axes.set_xlabel("true level", fontsize=8)
            axes.set_ylabel("estimated level", fontsize=8)
    panels[0][0].legend(fontsize=7, loc="lower right")
    save_figure(figure, path)


def stair_maps(maps: Mapping[str, NDArray[np.floating]], levels: int, path: PathLike) -> None:
    """Draw true and estimated maps of a stair side by side, squeezed (thesis figures 6.2, 6.3).

    Parameters
    ----------
    maps : mapping of str to ndarray of float, shape [rows, columns]
        Estimated levels; NaN is grey.
    levels : int
        Number of steps.
    """
    figure = new_figure(0.9 * (len(maps) + 2), 2 * PANEL_INCHES)
    true_map = np.arange(levels, dtype=np.float64)[:, None]
    shown = {"true": true_map, **maps}
    # Small blur sizes, near the camera, at the bottom.
    drawn = None
    for axes, (title, values) in zip(
        figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True
    ):
        axes.set_facecolor(_UNKNOWN)
        drawn = axes.imshow(
            values,
            aspect="auto",
            origin="lower",
            cmap="turbo",
            vmin=0,
            vmax=levels - 1,
            interpolation="nearest",
        )
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(title, fontsize=7)
    figure.colorbar(drawn, ax=figure.axes, label="level", fraction=0.03)
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
