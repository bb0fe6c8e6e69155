"""Blur with occlusion: against traced scenes, and its two forms against each other."""

import cv2
import numpy as np
import pytest
from deblur_scene import levin_basis, relief

from coded_aperture_ros.deblur.occlusion import OccludedBlur, collect, spread
from coded_aperture_ros.deblur.operator import SpreadingBlur, crop_to_frame
from coded_aperture_ros.deblur.psf_basis import PsfBasis
from coded_aperture_ros.deblur.visibility import quadrant_minimum, trace_visibility
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

BORDER = np.s_[16:-16, 16:-16]


@pytest.fixture(scope="module", params=["far", "near"])
def traced(request):
    """A random scene: how it was recorded, sharp, its blur sizes, and its PSFs."""
    mask = Mask.named("zhou")
    scene = random_scene(1_000_021, mask, request.param, (144, 160))
    blur = scene.blur_size_px()
    blur = np.where(np.isfinite(blur), blur, np.nanmedian(blur)).astype(np.float32)
    sizes = np.arange(blur.min() - 0.3, blur.max() + 0.6, 0.3)
    basis = PsfBasis.from_stack(render_psf_stack(mask, sizes))
    return scene.coded(), scene.all_in_focus(), blur, basis


def near_edges(blur):

    around = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(blur, around) - cv2.erode(blur, around) > 1).astype(np.uint8)
    return cv2.dilate(edge, np.ones((25, 25), np.uint8)) > 0


def test_it_explains_a_traced_scene_better_than_layers_that_are_added(traced):
    coded, sharp, blur, basis = traced
    near = near_edges(blur)[BORDER]
    assert near.mean() > 0.05
    errors = []
    for operator in (OccludedBlur(basis, blur), SpreadingBlur(basis, blur)):
        left = (operator.forward(operator.extend(sharp)) - coded)[BORDER]
        errors.append(np.sqrt(np.mean(left[near] ** 2)))
    assert errors[0] < 0.6 * errors[1]


def test_what_is_hidden_is_seen_only_beside_foregrounds():
    """A wall behind a square: with nothing behind the square, its rim is darker."""
    blur = np.full((100, 120), 11.0, np.float32)
    blur[40:80, 40:90] = 3.0
    operator = OccludedBlur(levin_basis(), blur)
    margin = operator.margin_px
    hidden = crop_to_frame(operator.hidden, operator)
    assert hidden[40:80, 40:90].any()
    assert not hidden[:40].any()
    assert not hidden[60, 40 + margin + 3 : 90 - margin - 3].any()
    scene = operator.extend(np.ones(blur.shape, np.float32))
    assert operator.forward(scene) == pytest.approx(1, abs=0.01)
    scene[1] = 0
    dark = operator.forward(scene) < 0.99
    assert dark.any()
    assert not dark[:30].any()
    assert not dark[52:68, 52:78].any()


@pytest.mark.parametrize("sign", [1, -1])
def test_both_forms_follow_the_same_rays(sign):
    pytest.importorskip("numba")
    random = np.random.default_rng(0)
    front = sign * relief((60, 70))[10:, 10:]
    sizes = front + random.uniform(0, 4, front.shape).astype(np.float32)
    sizes[random.random(front.shape) < 0.1] = -1e9
    steps = random.integers(0, 5, front.shape)
    offsets = np.argwhere(np.ones((9, 9))) - 4
    taps = random.random((81, 5)).astype(np.float32)
    edges = random.random((42, 52)) < 0.7
    least = quadrant_minimum(front, 4)
    forms = [np.empty((81, 10, 52), np.float32) for _ in range(3)]
    for form, weights in zip(
        (trace_visibility, trace_visibility.plain, trace_visibility.loop), forms, strict=True
    ):
        place = float(front.min()), 3, 4
        form((front, least, sizes, steps, edges), taps, offsets, place, weights)
    assert (forms[0] == 0).mean() > 0.15
    assert np.array_equal(forms[0], forms[1])
    assert np.array_equal(forms[2], forms[1])


def test_both_forms_add_up_the_same():
    pytest.importorskip("numba")
    random = np.random.default_rng(0)
    weights = random.integers(0, 255, (25, 6, 30)).astype(np.uint8)
    offsets = np.argwhere(np.ones((5, 5))) - 2
    scene = random.random((20, 36)).astype(np.float32)
    found = [np.empty((6, 30), np.float32) for _ in range(2)]
    for form, frame in zip((collect, collect.plain), found, strict=True):
        form(weights, offsets + 3, scene[4:], frame)
    assert found[0] == pytest.approx(found[1], rel=1e-4)
    scenes = [np.zeros((20, 36), np.float32) for _ in range(2)]
    for form, other in zip((spread, spread.plain), scenes, strict=True):
        form(weights, offsets + 3, found[1], other[4:])
    assert scenes[0] == pytest.approx(scenes[1], rel=1e-4)


def test_without_edges_nothing_is_hidden():
    operator = OccludedBlur(levin_basis(), np.full((50, 60), 5.0, np.float32))
    assert not operator.hidden.any()
