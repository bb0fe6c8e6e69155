"""Filters, networks and recorded work on PyTorch: what OpenCV does with arrays, for tensors."""

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.archive import read_shipped
from coded_aperture_ros.core.arrays import namespace, quantiles
from coded_aperture_ros.core.networks import network_of
from coded_aperture_ros.core.tensors.onnx_graph import Graph
from coded_aperture_ros.deblur.blend import blend
from coded_aperture_ros.depth.decoders.network import network, second

RANDOM = np.random.default_rng(0)
HIGH = np.array([1, 0, -2, 0, 1], np.float32) / 4
NETWORKS = {
    "levels": (network, {"levels": (5, 24, 8, 12)}),
    "cells": (
        network,
        {"costs": (1, 276, 8, 12), "frame": (1, 16, 16, 24), "levels": (1, 45, 8, 12)},
    ),
    "second": (second, {"shown": (1, 144, 8, 12)}),
    "blend": (blend, {"shown": (1, 101, 16, 24)}),
}


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


def shipped(module):
    return read_shipped(module.__file__, module.WEIGHTS, module.SCHEMA, module.SCHEMA_VERSION)


@pytest.mark.parametrize("name", NETWORKS)
def test_networks_are_read_without_the_package_onnx(name):
    module, inputs = NETWORKS[name]
    graph = Graph.from_bytes(shipped(module)[f"{name}_onnx"].tobytes())
    assert {node.kind for node in graph.nodes} <= {
        *("Conv", "ConvTranspose", "Relu", "Add", "Concat", "Resize")
    }
    made = {node.output for node in graph.nodes}
    used = {each for node in graph.nodes for each in node.inputs if each}
    assert graph.output in made and used - made - graph.weights.keys() == inputs.keys()
    filters = [node for node in graph.nodes if node.kind == "Conv"]
    for node in filters:
        assert list(graph.weights[node.inputs[1]].shape[2:]) == node.attributes["kernel_shape"]


def test_what_is_no_network_is_refused():
    with pytest.raises(ValueError, match="no ONNX form"):
        Graph.from_bytes(b"\x0b\x00")


@pytest.mark.parametrize("name", NETWORKS)
def test_networks_run_as_by_opencv(torch, name):
    from coded_aperture_ros.core.tensors.networks import TorchNetwork

    module, shapes = NETWORKS[name]
    arrays = shipped(module)
    inputs = {key: RANDOM.random(shape, np.float32) for key, shape in shapes.items()}
    expected = network_of(arrays, name, "opencv", 1)(inputs)
    tensors = {key: torch.from_numpy(values) for key, values in inputs.items()}
    found = TorchNetwork(arrays, name, "cpu")(tensors).numpy()
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("shape", [(121, 203), (33, 37)])
@pytest.mark.parametrize(
    "filtered",
    [
        lambda cv, picture: cv.blur(picture, (19, 19)),
        lambda cv, picture: cv.blur(picture, (33, 2)),
        lambda cv, picture: cv.blur(picture, (9, 9), borderType=cv.BORDER_REFLECT),
        lambda cv, picture: cv.GaussianBlur(picture, (0, 0), 1.5),
        lambda cv, picture: cv.resize(picture, (17, 11), interpolation=cv.INTER_AREA),
        lambda cv, picture: cv.resize(picture, (170, 111), interpolation=cv.INTER_LINEAR),
        lambda cv, picture: cv.resize(picture, (19, 90), interpolation=cv.INTER_NEAREST_EXACT),
        lambda cv, picture: cv.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv.INTER_AREA),
        lambda cv, picture: cv.copyMakeBorder(picture, 3, 8, 0, 9, cv.BORDER_REFLECT),
        lambda cv, picture: cv.dilate(picture, np.ones((5, 5), np.uint8)),
        lambda cv, picture: cv.erode(picture, np.ones((11, 11), np.uint8)),
        lambda cv, picture: cv.medianBlur(picture, 3),
        lambda cv, picture: cv.absdiff(picture[1:], picture[:-1]),
        lambda cv, picture: cv.sepFilter2D(picture, -1, HIGH, HIGH),
        lambda cv, picture: cv.boxFilter(
            picture, -1, (5, 9), normalize=False, borderType=cv.BORDER_CONSTANT
        ),
    ],
)
def test_tensors_are_filtered_as_by_opencv(torch, filtered, shape):
    from coded_aperture_ros.core.tensors import filters

    picture = RANDOM.random(shape, np.float32)
    expected = filtered(cv2, picture)
    found = filtered(filters, torch.from_numpy(picture)).numpy()
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < 1e-6 * max(np.abs(expected).max(), 1)


@pytest.mark.parametrize(
    "computed",
    [
        lambda xp, a: xp.minimum(a, 0.5),
        lambda xp, a: xp.maximum(a, a[::1] * 0.5 + 0.2),
        lambda xp, a: xp.sort(a, axis=0),
        lambda xp, a: xp.median(a),
        lambda xp, a: xp.std(a),
        lambda xp, a: xp.take(a, np.array([3, 0, 3]), axis=1),
        lambda xp, a: xp.take_along_axis(a, xp.asarray(a * 9, dtype=xp.int64), axis=0),
        lambda xp, a: xp.repeat(a, 3, axis=1),
        lambda xp, a: xp.copy(a),
        lambda xp, a: xp.bincount(xp.asarray(a.ravel() * 9, dtype=xp.int64), a.ravel(), 12),
        lambda xp, a: xp.bincount(xp.asarray(a.ravel() * 9, dtype=xp.int64), None, 12),
        lambda xp, a: quantiles(a, 0.1, 0.5, 1.0),
        lambda xp, a: quantiles(a, 0.1, 0.5, where=a[:, 0] > 0.4),
    ],
)
@pytest.mark.parametrize("rows", [11, 12])
def test_functions_mean_what_those_of_numpy_do(torch, computed, rows):
    values = RANDOM.random((rows, 7), np.float32)
    given = torch.from_numpy(values)
    expected, found = computed(namespace(values), values), computed(namespace(given), given)
    assert tuple(found.shape) == np.shape(expected)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-6)


@pytest.mark.parametrize("size", [10, 2**17])
def test_equal_constants_are_copied_once_and_large_ones_known_while_they_exist(torch, size):
    from coded_aperture_ros.core.tensors import constants

    device, values = torch.device("cpu"), np.arange(size, dtype=np.float32)
    first = constants.kept_on_device(values, device)
    assert constants.kept_on_device(values, device) is first
    assert constants.kept_on_device(values.copy(), device) is first
    np.testing.assert_array_equal(first.numpy(), values)
    kept = len(constants._large)
    values = values + 1
    assert len(constants._large) == kept - (size > 10)
    np.testing.assert_array_equal(constants.kept_on_device(values, device).numpy(), values)


def test_a_mean_in_place_is_that_of_opencv(torch):
    from coded_aperture_ros.core.tensors import filters

    given = RANDOM.random((3, 21, 33), np.float32)
    forms = ((cv2, given.copy()), (filters, torch.from_numpy(given.copy())))
    for cv, (one, other, total) in forms:
        cv.accumulateProduct(cv.subtract(one, other, one), other, total)
    (_, expected), (_, found) = forms
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-5, atol=1e-7)


def test_colours_are_shrunk_as_by_opencv(torch):
    from coded_aperture_ros.core.tensors import filters

    picture = RANDOM.random((40, 60, 3), np.float32)
    expected = cv2.resize(picture, (30, 20), interpolation=cv2.INTER_AREA)
    tensor = torch.from_numpy(picture)
    found = filters.resize(tensor, (30, 20), interpolation=filters.INTER_AREA)
    assert np.abs(found.numpy() - expected).max() < 1e-6


def test_like_colours_are_averaged_as_by_opencv(torch):
    from coded_aperture_ros.core.tensors import filters

    picture = RANDOM.uniform(0, 0.2, (40, 60, 3)).astype(np.float32)
    expected = cv2.bilateralFilter(picture, 5, 0.06, 2.5)
    found = filters.bilateralFilter(torch.from_numpy(picture), 5, 0.06, 2.5).numpy()
    assert np.abs(found - expected).max() < 1e-4


@pytest.mark.parametrize("order", [1, -1])
def test_tensors_are_interpolated_as_by_numpy(torch, order):
    from coded_aperture_ros.core.tensors.functions import interp

    places = np.sort(RANDOM.random(9))
    values = np.arange(9)[::order]
    at = np.append(RANDOM.uniform(-0.1, 1.1, 60), places).astype(np.float32)
    found = interp(torch.from_numpy(at), places, values).numpy()
    assert found == pytest.approx(np.interp(at, places, values), abs=1e-4)


def test_constants_are_copied_once(torch):
    from coded_aperture_ros.core.arrays import constant

    like = torch.zeros(2)
    numbers = np.arange(5)
    one = constant(numbers, like)
    assert constant(numbers.copy(), like) is one and one.tolist() == [0, 1, 2, 3, 4]
    assert constant(numbers.astype(np.float32), like) is not one
    assert constant(numbers, np.zeros(2)) is numbers


def test_recorded_work_takes_any_arrays(torch):
    from coded_aperture_ros.core.tensors.recorded import Recorded
    from coded_aperture_ros.core.tensors.transfer import download

    work = Recorded(lambda inputs: {"sum": inputs["one"] + inputs["other"]}, "cpu")
    one = np.arange(6, dtype=np.float32).reshape(2, 3)
    one.setflags(write=False)
    found = download(work({"one": one.T, "other": torch.ones(3, 2)}))
    assert np.array_equal(found["sum"], one.T + 1)
