"""Depth with the network on PyTorch: the same as by NumPy and OpenCV, without a look at values."""

import dataclasses

import numpy as np
import pytest

from coded_aperture_ros.depth import DepthConfig, DepthEstimator, estimate_video
from coded_aperture_ros.depth.focus_pair import FocusPair
from coded_aperture_ros.frames import Frame, View
from coded_aperture_ros.likelihood.bank import learn_bank, learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack
from coded_aperture_ros.optics.field import FieldCurvature
from coded_aperture_ros.pipeline import FramePipeline
from coded_aperture_ros.simulation.layered import random_scene

# Difference of levels that counts as none: rounding, of a hundredth of the least step of a map.
SAME = 0.01
SHARE = 0.999
# Some frequencies times blur sizes lie between two cells of the check's map: rounding decides.
HEALTH = 0.02
NOISE = 0.002


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


@pytest.fixture(scope="module", params=["torch", "cuda"])
def backend(request, torch):
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    return request.param


@pytest.fixture(scope="module")
def bank():
    return learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 12, 21)))


def frame_of(seed, shape, channels=3):
    """Return a coded frame of a random scene, each channel with another share of the light."""
    scene = random_scene(seed, Mask.named("levin"), "far", shape)
    coded = np.stack([scene.coded() * share for share in (0.9, 0.7, 0.8)], axis=-1)
    coded = coded + NOISE * np.random.default_rng(seed).standard_normal(coded.shape)
    return (coded if channels == 3 else coded.mean(axis=-1)).astype(np.float32)


def frames_of(kind):
    if kind == "grey":
        return [frame_of(1, (192, 240), 1)]
    if kind == "colour":
        return [frame_of(2, (192, 240))]
    if kind == "odd":
        return [frame_of(3, (201, 243))[:197, :231]]
    if kind == "holes":
        frame = frame_of(4, (192, 240))
        frame[20:60, 30:90] = np.nan
        frame[100:150, 120:200] = 1.0
        return [frame]
    if kind == "dark":
        return [np.zeros((96, 128), np.float32)]
    frame = frame_of(5, (192, 246))
    return [frame[:, step : step + 240] for step in range(0, 6, 2)]


def assert_same(found, expected):
    for name in ("level", "confidence", "std_dev_m", "depth_m"):
        one, other = getattr(found, name), getattr(expected, name)
        if other is None:
            assert one is None
            continue
        same = np.isclose(one, other, rtol=0.01, atol=SAME, equal_nan=True)
        assert same.mean() > SHARE, name
    assert (found.health is None) == (expected.health is None)
    if found.health is not None:
        assert found.health.value == pytest.approx(expected.health.value, abs=HEALTH)


@pytest.mark.parametrize("kind", ["grey", "colour", "odd", "holes", "dark", "video"])
def test_depth_is_that_of_the_processor(backend, bank, kind):
    frames = frames_of(kind)
    memory = 4.0 if kind == "video" else 0.0
    config = {"temporal_frames": memory, "threads": 1}
    usual = DepthEstimator(bank, DepthConfig(network="opencv", **config))
    on_device = DepthEstimator(bank, DepthConfig(backend=backend, **config))
    for frame in frames:
        assert_same(on_device.estimate(frame), usual.estimate(frame))
    usual.close()
    on_device.close()


def test_recorded_videos_are_those_of_the_processor(backend, bank):
    config = {"temporal_frames": 1.0, "threads": 1}
    found, expected = (
        list(estimate_video(DepthEstimator(bank, DepthConfig(**config, **own)), frames_of("video")))
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    assert len(found) == len(expected) == 3
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)


def test_colour_psfs_are_those_of_the_processor(backend):
    """Their costs are added up on the processor."""
    stack = render_psf_stack(Mask.named("levin"), np.linspace(2, 12, 21))
    wider = render_psf_stack(Mask.named("levin"), np.linspace(2.2, 12.2, 21))
    size = wider.psfs.shape[1]
    margin = (size - stack.psfs.shape[1]) // 2
    psfs = np.pad(stack.psfs, ((0, 0), (margin, margin), (margin, margin)))
    of_channels = np.stack([psfs, psfs, wider.psfs])
    stack = dataclasses.replace(stack, psfs=psfs, channel_psfs=of_channels)
    bank = learn_bank(stack)
    assert len(bank.channels) == 3
    (frame,) = frames_of("colour")
    found, expected = (
        DepthEstimator(bank, DepthConfig(**own)).estimate(frame)
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    assert_same(found, expected)


@pytest.mark.parametrize("size", [(96, 120), (50, 64)])
def test_maps_of_other_sizes_are_those_of_the_processor(backend, bank, size):
    (frame,) = frames_of("colour")
    found = DepthEstimator(bank, DepthConfig(backend=backend)).estimate(frame, size)
    expected = DepthEstimator(bank, DepthConfig(network="opencv")).estimate(frame, size)
    assert found.level.shape == size
    assert_same(found, expected)


@pytest.mark.parametrize("side", ["near", "far"])
def test_layers_of_the_network_are_those_of_the_processor(backend, side):
    """What is seldom asked for, and stays on the device: probabilities, features, outputs."""
    focus_m, near_m, far_m = (1.0, 1.1, 3.0) if side == "far" else (3.0, 1.0, 2.4)
    camera = Camera(600.0, focus_m, 240, 192, Mask.named("levin"), 30.0, side=side)
    bank = learn_bank_for_camera(camera, near_m, far_m, 27)
    (frame,) = frames_of("colour")
    asked = {"free_space_risk": 0.01, "second_surface": True, "unknown": "nearest"}
    found, expected = (
        DepthEstimator(bank, DepthConfig(**asked, **backend_config), camera).estimate(frame)
        for backend_config in ({"backend": backend}, {"network": "opencv"})
    )
    assert_same(found, expected)
    assert found.layers.keys() == expected.layers.keys() != set()
    for name, layer in expected.layers.items():
        same = np.isclose(found.layers[name].values, layer.values, rtol=0.01, equal_nan=True)
        assert same.mean() > 0.995, name


SEEN = Camera(600.0, 1.0, 240, 192, Mask.named("levin"), 30.0)
CASES = {
    "shot noise": (SEEN, {"noise": 0.002, "noise_gain": 1e-5}, ()),
    "lossy": (SEEN, {"least_noise": 0.004}, ()),
    "lens": (dataclasses.replace(SEEN, focal_length_mm=16.0), {}, ()),
    "curved": (dataclasses.replace(SEEN, field_curvature=FieldCurvature(0.05)), {}, ()),
    "reliability": (SEEN, {}, (0.2, 1.1, 0.05)),
    "moving": (SEEN, {"temporal_frames": 2.0, "moving_camera": "frames"}, ()),
    "binned": (SEEN.resized(480, 384), {}, ()),
}


@pytest.mark.parametrize("case", CASES)
def test_stages_that_are_asked_for_are_those_of_the_processor(backend, case):
    camera, config, reliability = CASES[case]
    bank = learn_bank_for_camera(camera, 1.1, 3.0, 27)
    bank = dataclasses.replace(bank, reliability=reliability)
    frames = frames_of("video" if case == "moving" else "holes")
    config |= {"threads": 1, "free_space_risk": 0.01}
    view = View(240, 192, 240, 192, is_binned=True) if case == "binned" else None
    found, expected = (
        FramePipeline(bank, camera, DepthConfig(**config, **own))
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    for light in frames:
        frame = Frame(light, view=view)
        one, other = found(frame), expected(frame)
        assert_same(one, other)
        layers = (estimate.layers["free_space"].values for estimate in (one, other))
        assert np.isclose(*layers, rtol=0.01, equal_nan=True).mean() > 0.995
    found.close()
    expected.close()


def test_levels_on_both_sides_stay_on_the_processor(backend):
    bank = learn_bank(render_psf_stack(Mask.named("zhou"), np.linspace(-8, 8, 33)))
    (frame,) = frames_of("grey")
    estimate = DepthEstimator(bank, DepthConfig(backend=backend)).estimate(frame)
    assert "side" in estimate.layers


def test_pairs_of_focus_settings_are_those_of_the_processor(backend):
    """The second frame has costs on the device; they are added on the processor."""
    camera = Camera(600.0, 1.0, 240, 192, Mask.named("levin"), 30.0)
    bank = learn_bank_for_camera(camera, 1.2, 3.0, 27)
    first, second = frame_of(6, (192, 240), 1), frame_of(7, (192, 240), 1)
    found, expected = (
        FocusPair(DepthEstimator(bank, DepthConfig(**own), camera), 1.05).estimate(first, second)
        for own in ({"backend": backend}, {"network": "opencv"})
    )
    assert_same(found, expected)


@pytest.fixture
def no_gpu(torch, monkeypatch):
    """PyTorch that computes nothing, but knows on which device results would be; and what is asked.

    All pixels of a frame are usable if `asked["usable"]`.
    """
    from torch._subclasses.fake_tensor import FakeTensorMode

    from coded_aperture_ros.core.tensors import constants, filters, recorded, transfer
    from coded_aperture_ros.depth.quality import health, on_device
    from coded_aperture_ros.depth.stages import static_average
    from coded_aperture_ros.frames import noise
    from coded_aperture_ros.likelihood import backends, torch_engine

    asked = {"usable": True, "values": 0, "devices": set(), "maps": []}

    def array_of(tensor):
        if isinstance(tensor, np.ndarray):
            return tensor
        asked["devices"].add(str(tensor.device))
        kind = {torch.bool: np.bool_, torch.float32: np.float32}[tensor.dtype]
        return np.full(tuple(tensor.shape), 1, kind)

    def download(tensors):
        asked["maps"].append(sorted(tensors))
        return {name: array_of(tensor) for name, tensor in tensors.items()}

    def uploaded(array):
        return torch.empty(array.shape, dtype=torch.from_numpy(array).dtype, device="cuda")

    def run(self, inputs):
        here = {name: isinstance(each, torch.Tensor) for name, each in inputs.items()}
        tensors = {name: each if here[name] else uploaded(each) for name, each in inputs.items()}
        return self._function(tensors)

    def look(tensor):
        asked["values"] += 1
        return asked["usable"]

    empty = torch.empty
    monkeypatch.setattr(torch, "empty", lambda *a, pin_memory=False, **k: empty(*a, **k))
    monkeypatch.setattr(torch.Tensor, "__bool__", look)
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: None)
    monkeypatch.setattr(backends, "_has_cuda", lambda: True)
    monkeypatch.setattr(torch_engine, "copy_without_waiting", lambda *_: None)
    monkeypatch.setattr(transfer, "download", download)
    monkeypatch.setattr(transfer, "upload_to", lambda device: uploaded)
    monkeypatch.setattr(recorded.Recorded, "__call__", run)
    for module in (on_device, health, noise, static_average):
        monkeypatch.setattr(module, "in_memory", array_of)
    forget = (constants.forget, filters._matrix.cache_clear, filters._border.cache_clear)
    try:
        with FakeTensorMode():
            for each in forget:
                each()
            yield asked
    finally:
        for each in forget:
            each()


@pytest.mark.parametrize("shape", [(192, 240), (193, 241, 3)])
@pytest.mark.parametrize("usable", [True, False])
def test_a_whole_frame_stays_on_its_device(no_gpu, shape, usable):
    """No value is looked at between the frame and its maps, but whether all pixels are usable."""
    no_gpu["usable"] = usable
    mask = Mask.named("levin")
    curvature = FieldCurvature(0.05)
    camera = Camera(600.0, 1.0, 240, 192, mask, 30.0, focal_length_mm=16.0)
    curved = dataclasses.replace(camera, field_curvature=curvature)
    asked = {"free_space_risk": 0.01, "second_surface": True, "unknown": "nearest"}
    config = DepthConfig(backend="cuda", temporal_frames=2.0, threads=1, **asked)
    for seen in (camera, curved):
        bank = learn_bank_for_camera(seen, 1.1, 3.0, 27)
        bank = dataclasses.replace(bank, reliability=(0.1, 1.0, 0.0))
        estimator = DepthEstimator(bank, config, seen)
        no_gpu.update(values=0, maps=[])
        stages = [estimator.estimate(np.full(shape, 0.3, np.float32)).seconds for _ in range(2)]
        assert no_gpu["devices"] == {"cuda:0"}
        assert no_gpu["values"] == 2
        assert len(no_gpu["maps"]) == 2
        assert {"layer free_space", "layer second", "std_dev_m"} <= set(no_gpu["maps"][0])
        assert {"static average", "temporal", "quality of fit", "reliability"} <= set(stages[0])
    assert "field doubt" not in stages[0]


@pytest.mark.parametrize("kind", ["colour", "holes", "video"])
def test_little_is_copied_from_the_device_before_the_maps(torch, bank, kind):
    """On a GPU each copy waits; NumPy's functions would copy tensors without a word."""
    from coded_aperture_ros.core import arrays
    from coded_aperture_ros.core.tensors import transfer

    copied, downloads, conversions = [], [], []

    def convert(tensor, *_, **__):
        conversions.append(tuple(tensor.shape))
        return tensor.detach().numpy()

    asked = {"free_space_risk": 0.01, "second_surface": True, "unknown": "nearest"}
    memory = 4.0 if kind == "video" else 0.0
    config = DepthConfig(backend="torch", temporal_frames=memory, threads=1, **asked)
    estimator = DepthEstimator(bank, config)
    with pytest.MonkeyPatch.context() as patch:
        usual = transfer.download
        patch.setattr(transfer, "download", lambda x: copied.append(list(x)) or usual(x))
        patch.setattr(torch.Tensor, "__array__", convert)
        in_memory = arrays.in_memory
        for module in (
            "depth.quality.on_device",
            "depth.quality.health",
            "frames.noise",
            "depth.stages.static_average",
        ):
            name = f"coded_aperture_ros.{module}.in_memory"
            patch.setattr(name, lambda x: downloads.append(x.shape) or in_memory(x), raising=False)
        healths = [estimator.estimate(frame).health for frame in frames_of(kind)]
    estimator.close()
    assert conversions == []
    assert len(copied) == len(frames_of(kind))
    # Rows of numbers, and maps of patches; whether it is a depth map is asked of a misfit.
    pixels = [int(np.prod(shape)) for shape in downloads]
    whole = sum(each >= 192 * 240 / 60 for each in pixels)
    assert pixels
    assert whole <= sum(not each.fits for each in healths)


def recorded_work(torch, bank, frame):
    """Return the recorded functions of a frame by name, and what each is given."""
    from coded_aperture_ros.core.tensors import recorded

    estimator = DepthEstimator(bank, DepthConfig(backend="torch", temporal_frames=2.0))
    given = {}
    with pytest.MonkeyPatch.context() as patch:

        def take(self, inputs):
            tensors = {name: recorded.tensor_of(values) for name, values in inputs.items()}
            given[self._function.func.__name__] = self._function, tensors
            return self._function(tensors)

        patch.setattr(recorded.Recorded, "__call__", take)
        with torch.inference_mode():
            estimator.estimate(frame)
            estimator.estimate(frame)
    return given


@pytest.mark.parametrize("name", ["_decide", "_row"])
def test_a_frame_can_be_recorded(torch, bank, name):
    """Neither values are looked at nor constants copied: a CUDA graph allows neither."""
    from torch.utils._python_dispatch import TorchDispatchMode

    called = set()

    class Listen(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            called.add(func.overloadpacket.__name__)
            return func(*args, **(kwargs or {}))

    function, inputs = recorded_work(torch, bank, frames_of("holes")[0])[name]
    with torch.inference_mode(), Listen():
        function(inputs)
    assert {"convolution", "conv2d", "fft_rfft2"} & called
    assert called.isdisjoint(
        {"_local_scalar_dense", "item", "nonzero", "masked_select", "lift_fresh", "_to_copy"}
    )
