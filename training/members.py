"""Networks of the check of fit, side by side, and the arrays that they are stored as."""

import numpy as np
import torch
from shards import Arrays
from torch import nn
from torch.nn import functional

from coded_aperture_ros.depth import CAUSES
from coded_aperture_ros.depth.quality import health as package

# So many networks, from other beginnings, are fitted, and the mean of their outputs is taken.
MEMBERS = 8
_HIDDEN = 256
_LAYERS = 3
_CHUNK = 4096
_NOISE = 0.2
_DROPPED = 0.5


class Members(nn.Module):
    """Networks with two hidden layers, side by side, and what standardises their features.

    Takes features [batch, features], gives the logit of the depth being right, and then those of
    the causes [members, batch, outputs].
    """

    def __init__(self, arrays: Arrays, fixed: int = 0) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(arrays["mean"]))
        self.register_buffer("scale", torch.tensor(arrays["scale"]))
        self.weights = nn.ParameterList(_parameters(arrays, "weight"))
        self.biases = nn.ParameterList(_parameters(arrays, "bias"))
        for parameter in (*self.weights, *self.biases):
            parameter.register_hook(lambda slope: _without_fixed(slope, fixed))

    @classmethod
    def random(cls, features: np.ndarray) -> "Members":
        """Members before any fit, for features [frames, features]."""
        count = features.shape[1]
        sizes = (count, _HIDDEN, _HIDDEN // 2, 1 + len(CAUSES))
        clipped = _clipped(features)
        arrays = {
            "mean": np.tile(clipped.mean(0), (MEMBERS, 1)),
            "scale": np.tile(clipped.std(0) + 1e-3, (MEMBERS, 1)),
        }
        random = np.random.default_rng(0)
        for layer in range(_LAYERS):
            given, found = sizes[layer : layer + 2]
            limit = given**-0.5
            arrays[f"weight{layer}"] = random.uniform(-limit, limit, (MEMBERS, found, given))
            arrays[f"bias{layer}"] = random.uniform(-limit, limit, (MEMBERS, found))
        return cls({name: np.float32(values) for name, values in arrays.items()})

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        limit = package.LIMIT
        given = features.clamp(-limit, limit)[None]
        limit = package.SCALED_LIMIT
        values = ((given - self.mean[:, None]) / self.scale[:, None]).clamp(-limit, limit)
        if self.training:
            values = values + _NOISE * torch.randn_like(values)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = torch.baddbmm(bias[:, None], values, weight.transpose(1, 2))
            if layer < _LAYERS - 1:
                values = functional.relu(values)
            if layer == 0:
                values = functional.dropout(values, _DROPPED, self.training)
        return values

    def means(self, features: torch.Tensor) -> torch.Tensor:
        """Mean outputs of all members [frames, outputs]; without gradients."""
        with torch.no_grad():
            return torch.cat([self(some).mean(0) for some in features.split(_CHUNK)])


def _parameters(arrays: Arrays, name: str) -> list[nn.Parameter]:
    return [nn.Parameter(torch.tensor(arrays[f"{name}{layer}"])) for layer in range(_LAYERS)]


def _without_fixed(slope: torch.Tensor, fixed: int) -> torch.Tensor:
    changes = torch.arange(len(slope), device=slope.device) % MEMBERS >= fixed
    return slope * changes.view(-1, *[1] * (slope.ndim - 1))


def merged(state: dict[str, torch.Tensor]) -> Arrays:
    """Arrays of the members: the mean weights of twins."""

    def mean(name: str) -> np.ndarray:
        return state[name].unflatten(0, (-1, MEMBERS)).mean(0).cpu().numpy()

    arrays = {name: mean(name) for name in ("mean", "scale")}
    for layer in range(_LAYERS):
        arrays[f"weight{layer}"] = mean(f"weights.{layer}")
        arrays[f"bias{layer}"] = mean(f"biases.{layer}")
    return arrays


def _clipped(features: np.ndarray) -> np.ndarray:
    return np.clip(features, -package.LIMIT, package.LIMIT)


def stored(arrays: Arrays) -> Arrays:
    """Arrays as the weights' file has them: weights in 8 bits, by a scale for each row, rest in 16.

    Health changes by less than 0.01.
    """
    small = {}
    for name, values in arrays.items():
        if name.startswith("weight"):
            scale = np.abs(values).max(axis=-1, keepdims=True).astype(np.float16) / np.float16(127)
            small[f"{name}_scale"] = scale
            values = np.rint(values / scale.astype(np.float32)).clip(-127, 127).astype(np.int8)
        small[name] = values if values.dtype == np.int8 else values.astype(np.float16)
    return small


def unpacked(arrays: Arrays) -> Arrays:
    """Arrays of the weights' file, see `stored`, in single precision."""
    whole = {}
    for name, values in arrays.items():
        if name.endswith("_scale"):
            continue
        factor = arrays.get(f"{name}_scale", np.ones(1, np.float16))
        whole[name] = values.astype(np.float32) * factor.astype(np.float32)
    return whole
