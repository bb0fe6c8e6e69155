"""Cost of every blur level of a frame: the interface of the methods, scoring, and engines."""

from coded_aperture_ros.likelihood.backends import (
    BACKENDS,
    EngineLikelihood,
    check_backend,
    new_engine,
    torch_device,
)
from coded_aperture_ros.likelihood.channels import ChannelLikelihood
from coded_aperture_ros.likelihood.numpy_engine import NumpyEngine
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.protocol import (
    BlurLevels,
    Cost,
    Likelihood,
    LikelihoodModel,
    MotionField,
)
from coded_aperture_ros.likelihood.scoring import (
    bounded_cost,
    plausible_ratios,
    relative_cost,
    take_logarithm,
)

__all__ = [
    "BACKENDS",
    "BlurLevels",
    "ChannelLikelihood",
    "Cost",
    "EngineLikelihood",
    "Likelihood",
    "LikelihoodModel",
    "MotionField",
    "NumpyEngine",
    "Plan",
    "bounded_cost",
    "check_backend",
    "new_engine",
    "plausible_ratios",
    "relative_cost",
    "take_logarithm",
    "torch_device",
]
