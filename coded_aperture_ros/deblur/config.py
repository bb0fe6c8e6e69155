"""Settings of the deblurring."""

import dataclasses

from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.workers import check_threads
from coded_aperture_ros.likelihood import BACKENDS, check_backend


@dataclasses.dataclass(frozen=True)
class DeblurConfig:
    """How a coded frame is turned into an all-in-focus one."""

    method: str = option(
        "fast",
        "fast: closed form for each level, for video; cg: least squares over the whole frame; "
        "sparse: the same with sharp edges preferred, the best picture.",
        choices=("fast", "cg", "sparse"), parameter="deblur.method",
    )  # fmt: skip
    noise: float = option(
        0.0, "Standard deviation of one channel's noise, linear light; 0: estimated in each frame.",
        minimum=0.0, maximum=0.5, parameter="noise.sigma",
    )  # fmt: skip
    noise_gain: float = option(
        0.0,
        "Variance of one channel's shot noise per unit of light; adds to the variance of noise.",
        minimum=0.0, maximum=0.1, parameter="noise.gain",
    )  # fmt: skip
    smoothness: float = option(
        1.0, "Trades sharpness (below 1) against noise and ringing (above 1).",
        minimum=0.01, maximum=100.0, parameter="deblur.smoothness",
    )  # fmt: skip
    edge_reach: int = option(
        10,
        "How far edges of the depth may be off, or be wrong by: within, the smaller blur is used; "
        "0: the depth is exact.",
        unit="px", minimum=0, maximum=64, parameter="deblur.edge_reach",
    )  # fmt: skip
    occlusion: str = option(
        "auto",
        "Whether cg and sparse reckon with foregrounds that hide a part of what is behind them; "
        "auto: sparse does, where the PSFs are small enough for the memory.",
        choices=("auto", "yes", "no"), parameter="deblur.occlusion",
    )  # fmt: skip
    iterations: int = option(
        112, "Conjugate-gradient steps of cg and sparse, at most.",
        minimum=1, maximum=10000, parameter="deblur.iterations",
    )  # fmt: skip
    tolerance: float = option(
        1e-3,
        "Norm of the gradient at which cg and sparse stop, relative to that of a black picture.",
        minimum=0.0, maximum=1.0, parameter="deblur.tolerance",
    )  # fmt: skip
    saturation: float = option(
        0.995,
        "Brightness from which a pixel counts as saturated and is left out by cg and sparse; "
        "above 1: none.",
        minimum=0.1, maximum=2.0, parameter="frames.saturation",
    )  # fmt: skip
    temporal_frames: float = option(
        0.0,
        "Frames of a video that are averaged at most, where they are alike; 0: every frame for "
        "itself.",
        minimum=0.0, maximum=1000.0, parameter="temporal.frames",
    )  # fmt: skip
    rank: int = option(
        10,
        "Kernels in the common basis of the inverse filters of fast. Fewer is faster and less "
        "accurate.",
        minimum=2, maximum=64, read_only=True, parameter="deblur.rank",
    )  # fmt: skip
    band: str = option(
        "full",
        "Frequencies that fast deblurs: half, the lower half, takes half of the time, and "
        "leaves details where the blur is only a few pixels as they are.",
        choices=("full", "half"), read_only=True, parameter="deblur.band",
    )  # fmt: skip
    backend: str = option(
        "numpy",
        "What cg computes with: torch needs PyTorch, cuda a GPU beside; auto takes the GPU where "
        "there is one.",
        choices=BACKENDS, parameter="compute.backend",
    )  # fmt: skip
    threads: int = option(
        1, "Threads of the processor for the filters; at most as many as it has cores.",
        minimum=1, maximum=1024, read_only=True, parameter="compute.threads",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_options(self)
        check_backend(self.backend)
        check_threads(self.threads)
