"""Figures of reliability diagrams."""

from collections.abc import Mapping

import numpy as np

from coded_aperture_ros.core.figures import PANEL_INCHES, PathLike, new_figure, save_figure
from coded_aperture_ros.metrics.reliability import Reliability


def reliability_diagram(curves: Mapping[str, Reliability], path: PathLike, right: str) -> None:
    """Draw the share of right estimates against their confidence, and the number of estimates.

    `right` says on the axis what counts as right.
    """
    figure = new_figure(1.8 * PANEL_INCHES, 2.0 * PANEL_INCHES)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    top.plot([0, 1], [0, 1], "k--", linewidth=0.8)
    for name, curve in curves.items():
        error = curve.expected_calibration_error
        label = f"{name}: calibration error {error:.3f}"
        top.plot(curve.mean_confidence, curve.share_right, "o-", markersize=4, label=label)
        edges = np.linspace(0, 1, len(curve.count) + 1)
        bottom.stairs(curve.count / max(curve.count.sum(), 1), edges)
    top.set_xlim(0, 1)
    top.set_ylim(0, 1)
    top.set_ylabel(f"share {right}", fontsize=9)
    top.legend(fontsize=7, loc="upper left")
    bottom.set_ylim(0)
    bottom.set_xlabel("confidence")
    bottom.set_ylabel("share of pixels", fontsize=9)
    save_figure(figure, path)
