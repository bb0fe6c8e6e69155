"""A network of the size of MiDaS small, with random weights: the time of depth from one picture.

Its layers are those of MiDaS v2.1 small: the encoder EfficientNet-Lite3 without its head, and four
blocks that fuse its features. It says nothing about accuracy.

References
----------
R. Ranftl et al., Towards Robust Monocular Depth Estimation: Mixing Datasets for Zero-shot
Cross-dataset Transfer, IEEE TPAMI 44(3), 2022. M. Tan and Q. Le, EfficientNet: Rethinking Model
Scaling for Convolutional Neural Networks, ICML 2019.
"""

import dataclasses
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, Shape

INPUT_PX = 256
# Stages of EfficientNet-Lite3: expansion, channels, blocks, stride of the first one, kernel.
_STAGES = (
    (1, 24, 1, 1, 3),
    (6, 32, 3, 2, 3),
    (6, 48, 3, 2, 5),
    (6, 96, 5, 2, 3),
    (6, 136, 5, 1, 5),
    (6, 232, 6, 2, 5),
    (6, 384, 1, 1, 3),
)
_STEM_CHANNELS = 32
# Stages after which features are taken, and the channels that they are fused in.
_FEATURES = {1: 64, 2: 128, 4: 256, 6: 512}
# Of the pictures that such a network was trained with.
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


def unsupported_reason() -> str:
    """Why the network cannot be made or run here; empty if it can."""
    missing = [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]
    return f"no monocular network: pip install {' '.join(missing)}" if missing else ""


@dataclasses.dataclass(frozen=True)
class Model:
    """A network, and what it takes.

    Attributes
    ----------
    content : bytes
        ONNX file.
    parameters : int
    multiply_adds : int
        Of the convolutions.
    """

    content: bytes
    parameters: int
    multiply_adds: int


class _Graph:
    """Graph of convolutions; a tensor is its name, channels, rows and columns are kept beside."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.parameters = 0
        self.multiply_adds = 0
        self.shapes: dict[str, tuple[int, int, int]] = {"picture": (3, INPUT_PX, INPUT_PX)}
        self._random = np.random.default_rng(0)

    def add(self, kind: str, inputs: list[str], shape: tuple[int, int, int], **how: Any) -> str:
        """Add a node; return its output."""
        from onnx import helper

        name = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **how))
        self.shapes[name] = shape
        return name

    def constant(self, values: NDArray[Any]) -> str:
        """Add an array; return its name."""
        from onnx import numpy_helper

        name = f"weights_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(values, name))
        return name

    def convolve(
        self,
        source: str,
        channels: int,
        kernel: int,
        stride: int = 1,
        *,
        depthwise: bool = False,
        activation: str = "",
    ) -> str:
        """Add a convolution with a bias, into which a normalisation would be folded."""
        inputs, rows, columns = self.shapes[source]
        depth = 1 if depthwise else inputs
        shape = (channels, -(-rows // stride), -(-columns // stride))
        weights = self._random.normal(size=(channels, depth, kernel, kernel)).astype(np.float32)
        weights *= np.float32(np.sqrt(2.0 / (depth * kernel**2)))
        self.parameters += weights.size + channels
        self.multiply_adds += weights.size * shape[1] * shape[2]
        name = self.add(
            "Conv",
            [source, self.constant(weights), self.constant(np.zeros(channels, np.float32))],
            shape,
            kernel_shape=[kernel, kernel],
            strides=[stride, stride],
            pads=[kernel // 2] * 4,
            group=inputs if depthwise else 1,
        )
        if activation == "relu6":
            limits = [self.constant(np.array(limit, np.float32)) for limit in (0, 6)]
            return self.add("Clip", [name, *limits], shape)
        return self.add("Relu", [name], shape) if activation else name

    def sum(self, first: str, second: str) -> str:
        """Add two tensors."""
        return self.add("Add", [first, second], self.shapes[first])

    def enlarge(self, source: str) -> str:
        """Enlarge twice, linearly."""
        channels, rows, columns = self.shapes[source]
        scales = self.constant(np.array([1, 1, 2, 2], np.float32))
        how = {"mode": "linear", "coordinate_transformation_mode": "align_corners"}
        return self.add("Resize", [source, "", scales], (channels, 2 * rows, 2 * columns), **how)

    def residual(self, source: str) -> str:
        """Two convolutions, each after a rectifier, and the source added."""
        channels = self.shapes[source][0]
        found = source
        for _ in range(2):
            found = self.add("Relu", [found], self.shapes[found])
            found = self.convolve(found, channels, 3)
        return self.sum(found, source)


def midas_small() -> Model:
    """Network for pictures of `INPUT_PX` squared, with random weights."""
    from onnx import TensorProto, checker, helper

    graph = _Graph()
    features = _encode(graph)
    path = ""
    for index, feature in enumerate(reversed(features)):
        joined = graph.sum(path, graph.residual(feature)) if path else feature
        path = graph.enlarge(graph.residual(joined))
        channels = graph.shapes[path][0]
        last = index == len(features) - 1
        path = graph.convolve(path, channels if last else channels // 2, 1)
    path = graph.enlarge(graph.convolve(path, 32, 3))
    path = graph.convolve(path, 32, 3, activation="relu")
    output = graph.convolve(path, 1, 1, activation="relu")
    side = ("picture", 3, INPUT_PX), (output, 1, INPUT_PX)
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, channels, pixels, pixels])
        for name, channels, pixels in side
    ]
    made = helper.make_graph(graph.nodes, "midas_small", ends[:1], ends[1:], graph.weights)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    checker.check_model(model)
    return Model(model.SerializeToString(), graph.parameters, graph.multiply_adds)


def _encode(graph: _Graph) -> list[str]:
    """Features of four scales, the finest first, in the channels that they are fused in."""
    features = []
    tensor = graph.convolve("picture", _STEM_CHANNELS, 3, 2, activation="relu6")
    for stage, (expansion, channels, blocks, first_stride, kernel) in enumerate(_STAGES):
        for block in range(blocks):
            inputs = graph.shapes[tensor][0]
            stride = 1 if block else first_stride
            inner = tensor
            if expansion > 1:
                inner = graph.convolve(inner, expansion * inputs, 1, activation="relu6")
            wide = graph.shapes[inner][0]
            inner = graph.convolve(inner, wide, kernel, stride, depthwise=True, activation="relu6")
            inner = graph.convolve(inner, channels, 1)
            same = stride == 1 and inputs == channels
            tensor = graph.sum(inner, tensor) if same else inner
        if stage in _FEATURES:
            features.append(graph.convolve(tensor, _FEATURES[stage], 3))
    return features


class Monocular:
    """Depth map of a sharp colour picture, of the picture's size.

    Parameters
    ----------
    threads : int
        Of ONNX Runtime.
    """

    def __init__(self, threads: int) -> None:
        import onnxruntime

        self.model = midas_small()
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        # As the networks of depth run: threads that spin would take the time of the other ways.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self._session = onnxruntime.InferenceSession(
            self.model.content, options, providers=["CPUExecutionProvider"]
        )

    def __call__(self, picture: NDArray[np.uint8]) -> FloatArray:
        """Map of the network's last layer, float32 [rows, columns]; no depth.

        Parameters
        ----------
        picture : ndarray, uint8 [rows, columns, RGB]
        """
        size: Shape = (picture.shape[1], picture.shape[0])
        small = cv2.resize(picture, (INPUT_PX, INPUT_PX), interpolation=cv2.INTER_AREA)
        light = (small.astype(np.float32) / 255 - _MEAN) / _DEVIATION
        inputs = np.ascontiguousarray(light.transpose(2, 0, 1)[None])
        (found,) = self._session.run(None, {"picture": inputs})
        return np.asarray(cv2.resize(found[0, 0], size, interpolation=cv2.INTER_CUBIC))
