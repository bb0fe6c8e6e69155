"""Settings of deblurring."""

import dataclasses

from coded_aperture_ros.core.networks import check_runtime
from coded_aperture_ros.core.options import check_options, option, option_of
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.likelihood import check_backend


@dataclasses.dataclass(frozen=True)
class DeblurConfig:
    """Settings of deblurring; each field's `Option` has its unit, range and description.

    `temporal_frames` is the largest number of frames whose mean is taken, where they are alike. It
    is not that of `DepthConfig`, which says how fast the costs of past frames fade, without end.

    Raises
    ------
    InputError
        Naming the setting, its value and what is allowed.

    Examples
    --------
    >>> from coded_aperture_ros.deblur import DeblurConfig
    >>> DeblurConfig(method="sparse", smoothness=0.8).iterations
    0
    """

    parameter_group = "deblur."
    method: str = option(
        "fast",
        "fast: closed forms blended by a small network, for video; inverse: the closed form of "
        "each pixel's level, without it; cg: a few steps towards the sharp scene that explains "
        "the whole frame; sparse: many of them, the best picture.",
        choices=("fast", "inverse", "cg", "sparse"),
        daily=True,
    )
    noise: float = option_of(DepthConfig, "noise")
    noise_gain: float = option_of(DepthConfig, "noise_gain")
    smoothness: float = option(
        1.0,
        "Trades sharpness (below 1) against noise and ringing (above 1).",
        within=(0.01, 100.0),
        daily=True,
    )
    occlusion: str = option(
        "auto",
        "Whether cg and sparse model foregrounds that hide a part of what is behind them; "
        "auto: where the PSFs are small enough for the memory.",
        choices=("auto", "yes", "no"),
    )
    iterations: int = option(
        0,
        "Largest number of conjugate-gradient steps of cg and sparse; 0: the method's own.",
        within=(0, 10000),
    )
    tolerance: float = option(
        1e-3,
        "Norm of the gradient at which cg and sparse stop, relative to that of a black picture.",
        within=(0.0, 1.0),
    )
    saturation: float = option_of(DepthConfig, "saturation")
    temporal_frames: float = option(
        0.0,
        "Largest number of frames of a video that are averaged, where they are alike; 0: none.",
        within=(0.0, 1000.0),
        parameter="temporal.frames",
    )
    rank: int = option(
        10,
        "Kernels in the common basis of the inverse filters. Fewer is faster and less accurate.",
        within=(2, 64),
        read_only=True,
    )
    band: str = option(
        "full",
        "Frequencies that fast and inverse deblur: half, the lower half, without the network, "
        "takes a fifth of the time, and leaves details where the blur is only a few pixels as they "
        "are.",
        choices=("full", "half"),
        read_only=True,
    )
    threads: int = option(
        1,
        "Threads of the processor for the filters; at most as many as it has cores. 0: all cores, "
        "at most 4.",
        within=(0, 1024),
        read_only=True,
        parameter="compute.threads",
    )
    network: str = option_of(DepthConfig, "network")
    backend: str = option_of(DepthConfig, "backend")

    def __post_init__(self) -> None:
        check_options(self)
        thread_count(self.threads)
        check_runtime(self.network)
        check_backend(self.backend)
