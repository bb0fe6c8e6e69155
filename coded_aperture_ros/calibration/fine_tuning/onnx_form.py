"""Networks in the form that the package runs: written and read, normalisations folded."""

import io
import warnings
from collections.abc import Iterable, Mapping

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import nn

Arrays = dict[str, NDArray[np.float32]]
# Of a single-precision number; what is left out is below what half precision keeps.
_DROPPED_BITS = 12
# OpenCV reads this one.
_OPSET = 11
# A convolution and the normalisation after it, as children of a module.
_FOLDED_PAIRS = (("0", "1"), ("spatial", "norm"))


def round_weights(network: nn.Module) -> None:
    """Round weights to 11 significant bits, so that the file packs well."""
    half = 1 << (_DROPPED_BITS - 1)
    for parameter in network.parameters():
        bits = parameter.data.contiguous().view(torch.int32)
        bits = (bits + half) >> _DROPPED_BITS << _DROPPED_BITS
        parameter.data = bits.view(torch.float32)


def to_onnx(module: nn.Module, inputs: Mapping[str, torch.Tensor], output: str) -> np.ndarray:
    """Module in the form that OpenCV reads, as bytes, for maps of any size.

    Inputs are given by their names.
    """
    file = io.BytesIO()
    names = [*inputs, output]
    # All but the channels.
    free = {name: {place: f"{name}_{place}" for place in (0, 2, 3)} for name in names}
    with warnings.catch_warnings():
        # The newer exporter writes no version that OpenCV 4.6 reads.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module,
            tuple(inputs.values()),
            file,
            input_names=list(inputs),
            output_names=[output],
            dynamic_axes=free,
            dynamo=False,
            opset_version=_OPSET,
        )
    return np.frombuffer(file.getvalue(), np.uint8)


def onnx_weights(model: np.ndarray) -> Arrays:
    """Weights of a module that was written, by their names."""
    graph = onnx.load_from_string(model.tobytes()).graph
    return {one.name: numpy_helper.to_array(one) for one in graph.initializer}


def fold(network: nn.Module) -> None:
    """Fold batch normalisations into the convolutions before them."""
    network.eval()
    for parent, convolution, norm in _folded_pairs(network):
        module = network.get_submodule(parent)
        layers = dict(module.named_children())
        fused = nn.utils.fusion.fuse_conv_bn_eval(layers[convolution], layers[norm])
        setattr(module, convolution, fused)
        setattr(module, norm, nn.Identity())


def load_folded(network: nn.Module, weights: Arrays) -> None:
    """Take the weights of a network whose normalisations were folded.

    Here normalisations only add what is left of them. `renormalise` makes them what they were.
    """
    state = network.state_dict()
    weights = dict(weights)
    for parent, convolution, norm in _folded_pairs(network):
        prefix = f"{parent}." if parent else ""
        weights[f"{prefix}{norm}.bias"] = weights.pop(f"{prefix}{convolution}.bias")
        state[f"{prefix}{norm}.running_var"] -= network.get_submodule(f"{prefix}{norm}").eps
    unknown = [name for name in weights if name not in state]
    if unknown:
        raise SystemExit(f"the file has weights that the network lacks: {', '.join(unknown)}")
    for name, value in weights.items():
        state[name] = torch.from_numpy(np.array(value, np.float32)).reshape(state[name].shape)
    network.load_state_dict(state)


def renormalise(network: nn.Module, inputs: Iterable[tuple[torch.Tensor, ...]]) -> None:
    """Let the normalisations know what passes through them: the network gives what it gave."""
    moments: dict[nn.BatchNorm2d, list[torch.Tensor]] = {}

    def keep(norm: nn.BatchNorm2d, given: tuple[torch.Tensor], _: torch.Tensor) -> None:
        values = given[0].double().transpose(0, 1).flatten(1)
        moments.setdefault(norm, []).append(torch.stack([values.mean(1), (values**2).mean(1)]))

    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    hooks = [norm.register_forward_hook(keep) for norm in norms]
    network.eval()
    with torch.no_grad():
        for given in inputs:
            network(*given)
        for norm in norms:
            mean, square = torch.stack(moments[norm]).mean(0)
            variance = (square - mean**2).clamp(min=0) + norm.eps
            norm.bias += mean.float()
            norm.weight.copy_(variance.sqrt())
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance - norm.eps)
    for hook in hooks:
        hook.remove()


def _folded_pairs(network: nn.Module) -> list[tuple[str, str, str]]:
    """Names of modules, and in them of a convolution and the normalisation after it."""
    found = []
    for name, module in network.named_modules():
        children = dict(module.named_children())
        found += [
            (name, convolution, norm)
            for convolution, norm in _FOLDED_PAIRS
            if isinstance(children.get(norm), nn.BatchNorm2d)
        ]
    return found
