"""Settings of the depth estimate."""

import dataclasses

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.networks import RUNTIMES, check_runtime
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth.decoders.regularize import LEARNED, REGULARIZERS
from coded_aperture_ros.likelihood import BACKENDS, check_backend

# `temporal_frames` of nodes and bags, whose frames are those of a video.
VIDEO_FRAMES = 4.0


@dataclasses.dataclass(frozen=True)
class DepthConfig:
    """How a frame is turned into depth."""

    stride_px: int = option(
        0,
        "Distance between the patches whose depth is estimated; 0: as the bank says, which is 8 "
        "up to a blur of 22 px, unless it was learned for a time per frame.",
        unit="px",
        within=(0, 64),
        parameter="compute.stride_px",
    )
    regularize: str = option(
        LEARNED,
        "How the levels of neighbours are decided together: learned is a small network, trained on "
        "simulated scenes, and semiglobal where it was not; semiglobal needs nothing learned, "
        "graphcut is the slow reference.",
        choices=(*REGULARIZERS, LEARNED),
        parameter="regularize.method",
    )
    smoothness: float = option(
        1.0,
        "Strength of the spatial regularisation, relative to its default; learned has none.",
        within=(0.0, 100.0),
        parameter="regularize.smoothness",
    )
    edge_correction: float = option(
        0.28,
        "How much is taken off foregrounds, which windows fatten, as a share of the window; 0: "
        "nothing. Learned needs none.",
        within=(0.0, 1.0),
        parameter="regularize.edge_correction",
    )
    noise: float = option(
        0.0,
        "Standard deviation of one channel's noise, linear light; 0: estimated in each frame.",
        within=(0.0, 0.5),
        parameter="noise.sigma",
    )
    noise_gain: float = option(
        0.0,
        "Variance of one channel's shot noise per unit of light; adds to the variance of noise.",
        within=(0.0, 0.1),
        parameter="noise.gain",
    )
    least_noise: float = option(
        0.0,
        "The noise is not less than this, whatever a frame looks like: for cameras that compress "
        "their pictures, which hides noise and loses texture. JPEG files and videos say it.",
        within=(0.0, 0.5),
        parameter="noise.least",
    )
    saturation: float = option(
        0.995,
        "Brightness from which a pixel counts as saturated and is left out; above 1: none.",
        within=(0.1, 2.0),
        parameter="frames.saturation",
    )
    confidence_threshold: float = option(
        0.55,
        "Depth is unknown where the confidence is below this; that of classical regularisation is "
        "at most 0.90.",
        within=(0.0, 1.0),
        parameter="confidence.threshold",
    )
    unknown: str = option(
        "nothing",
        "What stands where depth is unknown: nothing (NaN), or nearest: the nearest depth that is "
        "plausible, for whoever must not run into anything.",
        choices=("nothing", "nearest"),
        parameter="confidence.unknown",
    )
    free_space_risk: float = option(
        0.0,
        "Give a bound that such a share of the pixels may be nearer than: 0.001 to 0.01; 0: none.",
        within=(0.0, 0.1),
        parameter="free_space.risk",
    )
    second_surface: bool = option(
        False,
        "Tell of a second surface where windows show two, such as a net and the wall behind it.",
        parameter="second_surface.enabled",
    )
    check_fit: bool = option(
        True,
        "Check whether frames fit the bank at all, and lower the confidence where they do not.",
        parameter="confidence.check_fit",
    )
    temporal_frames: float = option(
        0.0,
        "Frames of a video after which what was seen has lost most of its weight; 0: every frame "
        "for itself.",
        within=(0.0, 1000.0),
        parameter="temporal.frames",
    )
    backend: str = option(
        "numpy",
        "What computes the costs: torch needs PyTorch, cuda a GPU beside; auto takes the GPU "
        "where there is one.",
        choices=BACKENDS,
        parameter="compute.backend",
    )
    network: str = option(
        "auto",
        "What runs the networks: auto takes onnxruntime, twice as fast as opencv, if installed.",
        choices=RUNTIMES,
        parameter="compute.network",
    )
    threads: int = option(
        0,
        "Threads of the processor; at most as many as it has cores. 0: so many, but no more than "
        "four.",
        within=(0, 1024),
        parameter="compute.threads",
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.free_space_risk and self.regularize != LEARNED:
            raise InputError("free_space_risk: use 0, only regularize: learned gives a bound")
        if self.second_surface and self.regularize != LEARNED:
            raise InputError("second_surface: use false, only regularize: learned tells of it")
        thread_count(self.threads)
        check_backend(self.backend)
        check_runtime(self.network)
