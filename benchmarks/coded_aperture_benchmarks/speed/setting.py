"""What is measured, and how much of it."""

import dataclasses

from coded_aperture_ros.depth import DepthConfig, map_size
from coded_aperture_ros.likelihood.bank import LearnConfig

MASK = "levin"

Size = tuple[int, int]


@dataclasses.dataclass(frozen=True)
class Setting:
    """What is measured.

    Attributes
    ----------
    size : (int, int)
        Rows and columns of the main size.
    levels : int
        From 7 to 30 px.
    window_px, rank
        Of the bank.
    highest_frequency : float
        That the bank takes into account, cycles/px.
    stride_px : int
        Distance between patches.
    backend : str
        What computes the energies.
    threads : int
        Of the processor.
    temporal_frames : float
        0: every frame for itself.
    full_size : bool
        Maps as large as the frame, instead of within 320x240.
    """

    size: Size
    levels: int
    window_px: int
    rank: int
    highest_frequency: float
    stride_px: int
    backend: str
    threads: int
    temporal_frames: float
    full_size: bool

    @property
    def learn_config(self) -> LearnConfig:
        """How the bank is learned; raises `InputError` if it cannot be."""
        return LearnConfig(
            window_px=self.window_px, rank=self.rank, highest_frequency=self.highest_frequency
        )

    @property
    def depth_config(self) -> DepthConfig:
        """How depth is estimated; raises `InputError` if it cannot be here."""
        return DepthConfig(
            stride_px=self.stride_px,
            temporal_frames=self.temporal_frames,
            backend=self.backend,
            threads=self.threads,
        )


@dataclasses.dataclass(frozen=True)
class Extent:
    """How much is measured.

    Attributes
    ----------
    frames : int
        For every measurement; the main one has five times as many.
    sizes : tuple of (int, int)
        Rows and columns.
    repeats : int
        Of the methods that are slower than this one.
    denoised : tuple of int
        Frames that a non-local mean is of.
    accuracy : bool
        Whether the stair is measured, which needs its pictures.
    quick : bool
        Less of the table over strides and sizes.
    """

    frames: int
    sizes: tuple[Size, ...]
    levels: tuple[int, ...]
    threads: tuple[int, ...]
    repeats: int
    denoised: tuple[int, ...]
    accuracy: bool
    quick: bool


def published_size(shape: Size, full: bool = False) -> Size:
    """Return the size (rows, columns) of the map that is timed for frames of a shape.

    The largest whole fraction within 320x240, or the frame's own, which nodes publish by default.
    """
    return map_size(shape, "full" if full else "auto")


def thread_counts(most: int) -> tuple[int, ...]:
    """Return 1, 2, 4 and so on, and the most."""
    return tuple(sorted({most, *(2**power for power in range(most.bit_length()))}))
