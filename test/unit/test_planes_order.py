"""Planes whose distances are exchanged: told by a mask that was found from the other planes."""

import dataclasses

import numpy as np
import pytest
from planes_scene import WINDOW, blur_size_px, plane

from coded_aperture_ros.calibration.mask.fit import MaskFit, random_parts
from coded_aperture_ros.calibration.mask.sizes import LensSizes
from coded_aperture_ros.calibration.planes.calibrate import calibrate_planes, learn_bank_from_planes
from coded_aperture_ros.calibration.planes.checks import check_pictures
from coded_aperture_ros.calibration.planes.folder import load_planes
from coded_aperture_ros.calibration.planes.order import exchange_gains, refuse_exchanged
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.planes.search import MaskSearch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank import LearnConfig

SIZE = 120
EXTENT_PX = 12.0


def scene(count=8, **changes):
    """Planes beyond the focus, equally spaced in inverse depth."""
    depths_m = 1 / np.linspace(0.85, 0.25, count)
    images = tuple(plane(depth, i, size=SIZE, **changes) for i, depth in enumerate(depths_m))
    return Planes(images, depths_m, tuple(f"{i}.png" for i in range(count)))


def exchanged(planes, first, second):
    """Return planes two of which have each other's depth."""
    order = np.arange(len(planes.names))
    order[[first, second]] = second, first
    images = tuple(planes.images[i] for i in order)
    return dataclasses.replace(planes, images=images, names=tuple(planes.names[i] for i in order))


def gains(planes):
    """Gains by the true side of the focus, and sizes to start from that are true in proportion."""
    search = MaskSearch(planes, WINDOW)
    sizes = np.abs(blur_size_px(planes.depths_m))
    start = LensSizes(sizes.min() / sizes.max(), 1, EXTENT_PX, 1 / planes.depths_m)
    noise = search.likelihood.first_log_noise
    return exchange_gains(search, MaskFit(random_parts(1, 3), start, noise))


@pytest.fixture(scope="module")
def planes():
    return scene()


def test_planes_in_order_are_not_refused(planes):
    found = gains(planes)
    assert sorted(found) == [(i, i + 1) for i in range(7)]
    assert max(found.values()) < -2
    refuse_exchanged(planes, found)


@pytest.mark.parametrize(
    ("count", "changes"), [(8, {"noise": 0.004}), (8, {"mask": "zhou"}), (5, {}), (12, {})]
)
def test_other_right_lists_are_not_refused(count, changes):
    planes = scene(count, **changes)
    refuse_exchanged(planes, gains(planes))


@pytest.mark.parametrize("first", [1, 2, 3, 5])
def test_exchanged_neighbours_are_named(planes, first):
    wrong = exchanged(planes, first, first + 1)
    found = gains(wrong)
    assert found[first, first + 1] > 30
    with pytest.raises(InputError, match=f"{first + 1}.png.*{first}.png.*seem to be"):
        refuse_exchanged(wrong, found)


def test_exchanged_planes_are_told_among_few():
    wrong = exchanged(scene(5), 2, 3)
    assert gains(wrong)[2, 3] > 30


def test_four_planes_are_not_judged():
    assert gains(scene(4)) == {}


def test_planes_with_about_the_same_blur_are_not_judged(planes):
    close = dataclasses.replace(
        planes, depths_m=np.array([*planes.depths_m[:-1], planes.depths_m[-2] * 1.01])
    )
    assert (6, 7) not in gains(close)


def test_one_pair_or_the_planes_of_several_pairs_are_named(planes):
    quiet = {(i, i + 1): 29.0 for i in range(7)}
    refuse_exchanged(planes, quiet)
    with pytest.raises(InputError, match=r"^3.png and 4.png: .* 1.68675 and 1.97183 m.* swapped"):
        refuse_exchanged(planes, {**quiet, (3, 4): 31.0})
    with pytest.raises(InputError, match=r"^3.png, 4.png, 5.png: .*another order.*: .*check that"):
        refuse_exchanged(planes, {**quiet, (3, 4): 31.0, (4, 5): 32.5})


def test_a_picture_that_is_listed_twice_is_named(planes):
    images = (*planes.images[:5], planes.images[2].copy(), *planes.images[6:])
    with pytest.raises(InputError, match=r"2.png and 5.png: the same picture .* two depths: keep"):
        check_pictures(images, planes.names, WINDOW)


@pytest.mark.parametrize("learn", [calibrate_planes, learn_bank_from_planes])
def test_calibration_refuses_them(planes, monkeypatch, learn):
    for name, value in (("_FIRST_STEPS", 8), ("_COARSE_STEPS", 8), ("_FINE_STEPS", 25)):
        monkeypatch.setattr(f"coded_aperture_ros.calibration.planes.search.{name}", value)
    monkeypatch.setattr("coded_aperture_ros.calibration.planes.search._NEAREST_TO_FOCUS", (0.15,))
    with pytest.raises(InputError, match=r"3.png.*2.png.*seem to be"):
        learn(exchanged(planes, 2, 3), 9, LearnConfig(window_px=WINDOW, rank=16))


@pytest.mark.slow
def test_ray_traced_planes_that_are_exchanged_are_named(data_dir, monkeypatch):
    # Two rounds more change the gains by a tenth.
    monkeypatch.setattr("coded_aperture_ros.calibration.planes.search._FINE_ROUNDS", 1)
    planes = load_planes([data_dir / "rendered" / "calib"])
    search = MaskSearch(planes, 48)
    mixture = search.mixture()
    assert max(exchange_gains(search, mixture).values()) < 0
    for first in (1, 7, 13):
        wrong = exchanged(planes, first, first + 1)
        assert exchange_gains(MaskSearch(wrong, 48), mixture)[first, first + 1] > 30
