"""Steps of the decoder in few large operations: the same of tensors as of arrays of NumPy."""

import numpy as np
import pytest

from coded_aperture_ros.core.arrays import zeros
from coded_aperture_ros.depth.decoders import paths
from coded_aperture_ros.depth.decoders.network import array_forms
from coded_aperture_ros.depth.decoders.semi_global import semi_global_cost, smoothness_weights

RANDOM = np.random.default_rng(0)
COLOURS = 0.3 * RANDOM.standard_normal((3, 13, 17)).astype(np.float32)
VOTES = (
    RANDOM.integers(0, 12, (13, 17)),
    RANDOM.random((13, 17, 5), dtype=np.float32),
    16,
    COLOURS,
    RANDOM.choice([2, 5], (13, 17)),
)
PROBABILITIES = np.zeros((16, 50), np.float32)
PROBABILITIES[2:-2] = np.exp(-RANDOM.exponential(3, (12, 50)))


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="needs PyTorch")


def on_tensors(torch, form, *arguments):
    """Return what a form makes of tensors, as arrays."""
    given = [torch.from_numpy(a) if isinstance(a, np.ndarray) else a for a in arguments]
    found = form(*given)
    return [each.numpy() for each in (found if isinstance(found, tuple) else (found,))]


@pytest.mark.parametrize(
    ("form", "arguments"),
    [
        (array_forms.described, (PROBABILITIES, np.arange(2, 8, 0.5, dtype=np.float32))),
        (array_forms.counted, VOTES),
        (array_forms.counted, (*VOTES, slice(4, 11))),
        (array_forms.chosen, (COLOURS, RANDOM.random((3, 26, 34), dtype=np.float32))),
        (
            array_forms.drawn,
            (
                np.pad(RANDOM.random((10, 14), dtype=np.float32), 1, mode="edge"),
                RANDOM.integers(0, 192, (20, 28)),
                0.9,
            ),
        ),
        (array_forms.doubled, (COLOURS,)),
        (smoothness_weights, ((9, 7), 0.5, RANDOM.random((9, 7), dtype=np.float32))),
    ],
)
def test_tensors_give_what_arrays_do(torch, form, arguments):
    expected = form(*arguments)
    expected = expected if isinstance(expected, tuple) else (expected,)
    for one, other in zip(on_tensors(torch, form, *arguments), expected, strict=True):
        assert one.dtype == other.dtype
        assert one == pytest.approx(other, rel=1e-4, abs=1e-5)


def test_zeros_are_of_the_kind_of_an_array(torch):
    for like in (np.ones(2, np.float32), torch.ones(2)):
        made = zeros((2, 3), like)
        assert type(made) is type(like) and made.dtype == like.dtype and (made == 0).all()


def test_some_rows_are_counted_as_all_are():
    whole = array_forms.counted(*VOTES)
    for some in (slice(0, 4), slice(4, 11), slice(11, 13)):
        for part, of_all in zip(array_forms.counted(*VOTES, some), whole, strict=True):
            assert part == pytest.approx(of_all[some], rel=1e-5)


def test_paths_of_several_volumes_go_together(torch):
    from coded_aperture_ros.depth.decoders.network.on_device.paths import semi_global_costs

    shapes = [(9, 12, 7), (11, 10, 7)]
    volumes = [RANDOM.exponential(3.0, shape).astype(np.float32) for shape in shapes]
    light = [RANDOM.random(shape[:2], dtype=np.float32) for shape in shapes]
    found = semi_global_costs(*([torch.from_numpy(a) for a in some] for some in (volumes, light)))
    for one, volume, brightness in zip(found, volumes, light, strict=True):
        expected = semi_global_cost(volume, 1.0, brightness)
        assert one.numpy() == pytest.approx(expected, rel=1e-5, abs=1e-4)


def test_paths_of_tensors_are_those_of_arrays(torch):
    costs = RANDOM.exponential(3.0, (6, 2, 5, 4)).astype(np.float32)
    steps = RANDOM.uniform(0, 4, (5, 2, 1, 4)).astype(np.float32)
    tensors = [torch.from_numpy(each.copy()) for each in (costs, steps, 5 * steps)]
    paths.follow_paths(*tensors)
    paths.follow_paths(costs, steps, 5 * steps)
    assert tensors[0].numpy() == pytest.approx(costs, rel=1e-5)
