"""How much work a frame is.

- Operations are those of the matrix products, as `Plan` counts them, and of the sums that slide
  down the frame in the NumPy engine. All else is counted as none.
- Bytes are estimated from the sizes of arrays: each stage takes its arrays from memory once and
  leaves its results there once. Beside these only the horizontal transform is counted, which is
  larger than a cache and kept between the two passes of the spectra. What a thread keeps for a row
  of patches, the path costs of the regularisation and the constant matrices are taken to stay in
  the caches, and what the small stages after the decoding move is not counted. Both numbers are
  thus lower bounds, and so is the time that follows from them.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coded_aperture_benchmarks.speed.setting import Setting, Size
from coded_aperture_ros.likelihood import Plan
from coded_aperture_ros.likelihood.bank import FilterBank

ENGINE_STAGES = ("spectra", "energies")
TEMPORAL_STAGES = ("static average", "temporal")
# The stages whose work grows with the levels.
LEVEL_STAGES = ("energies", "temporal", "decode")


def flop_of_spectra(plan: Plan) -> float:
    """Return the operations of one frame's transforms and projections."""
    grid, n = plan.grid, plan.grid.window_px
    patches = grid.rows * grid.columns
    two_h = len(plan.horizontal)
    return 2.0 * (
        plan.pixel_rows * grid.columns * n / 2 * two_h  # both halves of a window are added up
        + plan.pixel_rows * grid.columns * len(plan.vertical) * two_h  # rows enter windows once
        + patches * len(plan.features) * float(plan.horizontal_counts.sum())
    )


def flop_of_hypotheses(plan: Plan) -> float:
    """Return the operations of one frame's energies."""
    patches = plan.grid.rows * plan.grid.columns
    return 2.0 * patches * plan.hypotheses.size * len(plan.contrasts) / len(plan.ratios)


def fitted_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the exponent ``s`` of ``y = c x^s``, by least squares of the logarithms."""
    return float(np.polynomial.Polynomial.fit(np.log(x), np.log(y), 1).convert().coef[1])


@dataclasses.dataclass(frozen=True)
class FrameWork:
    """Work on one frame, counted as the module says.

    Attributes
    ----------
    pixels : int
        Of the frame.
    stage_bytes : mapping of str to float
        For every stage.
    """

    pixels: int
    flop_spectra: float
    flop_hypotheses: float
    stage_bytes: Mapping[str, float]

    @classmethod
    def of(cls, bank: FilterBank, setting: Setting, shape: Size, size: Size) -> "FrameWork":
        """Count for frames of `shape` and maps of `size`, both rows and columns."""
        plan = Plan.for_frames(bank, shape, setting.stride_px)
        floats = np.dtype(np.float32).itemsize
        patches = plan.grid.rows * plan.grid.columns
        frame = floats * shape[0] * shape[1]
        horizontal = floats * plan.pixel_rows * len(plan.horizontal) * plan.grid.columns
        functions = floats * patches * len(plan.features)
        costs = floats * patches * bank.levels
        one_map = floats * size[0] * size[1]
        stages = {
            "observe": frame,
            "static average": 3 * frame,  # with the mean, before and after
            "spectra": frame + 2 * horizontal + functions,
            "energies": frame + functions + costs,  # with the noise of the frame
            "likelihood": 0,  # beside spectra and energies
            "temporal": 4 * costs,  # with that of the past, before and after
            "decode": 2 * costs + 3 * one_map,  # level, deviation, confidence
            "quality of fit": 0,
            "periodic texture": 0,
            "unknown": 0,
            "metric": 2 * one_map,  # blur size, depth
        }
        if not setting.temporal_frames:
            stages = {name: count for name, count in stages.items() if name not in TEMPORAL_STAGES}
        return cls(
            pixels=shape[0] * shape[1],
            flop_spectra=flop_of_spectra(plan),
            flop_hypotheses=flop_of_hypotheses(plan),
            stage_bytes={name: float(count) for name, count in stages.items()},
        )

    @property
    def flop(self) -> float:
        """Operations of the frame."""
        return self.flop_spectra + self.flop_hypotheses

    def bytes_of(self, stages: Sequence[str]) -> float:
        """Return the bytes that some stages move."""
        return sum(self.stage_bytes[name] for name in stages)

    def per_pixel(self) -> dict[str, Any]:
        """Return operations and bytes per pixel of the frame."""
        return {
            "flop": {
                "spectra": self.flop_spectra / self.pixels,
                "hypotheses": self.flop_hypotheses / self.pixels,
                "total": self.flop / self.pixels,
            },
            "bytes": {name: count / self.pixels for name, count in self.stage_bytes.items()}
            | {
                "engine": self.bytes_of(ENGINE_STAGES) / self.pixels,
                "total": self.bytes_of(list(self.stage_bytes)) / self.pixels,
            },
        }
