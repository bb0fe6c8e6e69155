"""Compiled loops for a moving camera, against what NumPy does without numba."""

import numpy as np
import pytest

from coded_aperture_ros.core.fast_math import exponential, logarithm
from coded_aperture_ros.depth.moving import Pinhole, carrying, matching, outcome
from coded_aperture_ros.depth.moving.edges import settle
from coded_aperture_ros.depth.moving.equations import add_equations
from coded_aperture_ros.depth.moving.fusion import fuse
from coded_aperture_ros.depth.moving.outcome_plain import ENTRIES, PUBLISHED

SHAPE = 24, 32
VIEW = Pinhole(SHAPE, (30.0, 31.0), (15.0, 12.0))
MOTION = np.array([[1, 0.02, 0.05, 0.1], [-0.02, 1, 0, -0.04], [-0.05, 0, 1, 0.2], [0, 0, 0, 1.0]])


@pytest.fixture
def random():
    return np.random.default_rng(3)


def forms(compiled):
    pytest.importorskip("numba")
    return compiled, compiled.plain, compiled.loop


def belief(random, shape=SHAPE):
    """Maps of inverse depth, variance, and a confidence that is 0 here and there."""
    inverse = random.uniform(0.2, 1.2, shape)
    confidence = random.uniform(0, 1, shape) * (random.uniform(size=shape) > 0.2)
    maps = inverse, np.square(inverse * random.uniform(0.01, 0.2, shape)), confidence
    return tuple(np.asarray(values, np.float32) for values in maps)


def assert_alike(found, atol=1e-4, rtol=2e-3):
    """Every result is that of the first form."""
    for other in found[1:]:
        for first, second in zip(found[0], other, strict=True):
            np.testing.assert_allclose(first, second, rtol=rtol, atol=atol)


def test_exponential_and_logarithm():
    x = np.linspace(-4, 1, 101).astype(np.float32)
    np.testing.assert_allclose([exponential(each) for each in x], np.exp(x), rtol=5e-5)
    assert 0 < exponential(np.float32(-1000)) < 2e-7
    x = np.geomspace(1e-8, 1e3, 101).astype(np.float32)
    np.testing.assert_allclose([logarithm(each) for each in x], np.log(x), atol=2e-5)


def test_forms_of_fusion(random):
    past, present = (tuple(m.ravel() for m in belief(random)) for _ in range(2))
    close = present[0] > 0.6
    past[0][close] = present[0][close] * 1.01
    found = [tuple(np.empty((3, past[0].size), np.float32)) for _ in range(3)]
    for form, maps in zip(forms(fuse), found, strict=True):
        form(past, present, np.float32(0.6), maps)
    assert_alike(found)
    unknown = past[2] == 0
    for values, own in zip(found[0], present, strict=True):
        np.testing.assert_array_equal(values[unknown], own[unknown])


@pytest.mark.parametrize("keep", [0.0, 0.9])
def test_forms_of_carrying(random, keep):
    past = belief(random)
    trust = np.float32(keep), np.float32(1.1), np.float32(3e-4)
    lights = tuple(random.uniform(0.1, 0.5, (2, *SHAPE)).astype(np.float32))
    found = [tuple(np.full((3, *SHAPE), 7, np.float32)) for _ in range(3)]
    all_forms = zip(forms(carrying.carry), forms(carrying.fill_cracks), found, strict=True)
    for carry, fill, maps in all_forms:
        buffers = (
            np.empty(SHAPE, np.int32),
            *np.empty((2, *SHAPE), np.float32),
            np.zeros(past[0].size, np.float32),
        )
        carry(past, lights, VIEW.way(MOTION), trust, buffers, maps)
        fill(maps)
    sure = [maps[2] > 0 for maps in found]
    assert (sure[0].mean() > 0.5) == (keep > 0)
    known = [tuple(np.where(sure[0], values, 0) for values in maps) for maps in found]
    assert_alike(known)


def test_forms_of_comparison(random):
    pair = tuple(random.uniform(0.3, 0.6, (2, *SHAPE)).astype(np.float32))
    inverse, variance, _ = belief(random)
    compared, judged, differences = [], [], []
    three = forms(matching.compare), forms(matching.judge), forms(matching.differ)
    for compare, judge, differ in zip(*three, strict=True):
        scales, products = (tuple(np.empty((n, *SHAPE), np.float32)) for n in (2, 4))
        compare(pair, VIEW.way(MOTION), inverse, scales, products)
        compared.append((*scales, *products))
        judged.append(tuple(np.empty((3, *SHAPE), np.float32)))
        limits = np.float32(0.02), np.float32(0.3)
        first = compared[0]
        judge(first[2:], first[:2], (inverse, variance), limits, judged[-1])
        some = np.ascontiguousarray(pair[0][::2, ::2]), pair[1]
        differences.append(tuple(np.empty((2, 12, 16), np.float32)))
        few = np.ascontiguousarray(inverse[::2, ::2])
        differ(some, VIEW.way(MOTION), 2, few, differences[-1])
    assert 0.02 < compared[0][5].mean() < 0.5
    assert_alike(compared, atol=0.01)  # OpenCV looks at 32 places between two pixels
    assert_alike(differences, atol=0.01)
    assert_alike(judged)


def test_forms_of_edges(random):
    """Light of a near square before a far wall, which is believed to be larger than it is."""
    now, earlier = random.uniform(0.3, 0.6, (2, *SHAPE)).astype(np.float32)
    inverse = np.full(SHAPE, 0.3, np.float32)
    inverse[8:16, 10:20] = 0.9
    nearest, farthest = np.full(SHAPE, 0.9, np.float32), np.full(SHAPE, 0.3, np.float32)
    nearest[:, 28:] = 0.3
    found = [(np.empty(SHAPE, np.float32),) for _ in range(3)]
    surfaces = inverse, nearest, farthest
    for form, maps in zip(forms(settle), found, strict=True):
        form((now, earlier), VIEW.way(MOTION), surfaces, np.float32(0.002), *maps)
    changed = found[0][0] != inverse
    assert 3 < changed.sum() < 300 and not changed[:8, 28:].any()
    assert set(np.unique(found[0][0])) == set(np.unique(inverse))
    assert_alike(found)


def test_forms_of_equations(random):
    points = random.uniform(-0.4, 0.4, (30, 2)), random.uniform(0.2, 1, 30), np.full(30, 1e-3)
    pixels = random.uniform(0, 30, (30, 2))
    found = [(np.empty(30), np.empty((7, 6))) for _ in range(3)]
    for form, results in zip(forms(add_equations), found, strict=True):
        form(points, pixels, (VIEW.focal_px, VIEW.centre), MOTION, results)
    assert_alike(found, rtol=1e-9)


@pytest.mark.parametrize("shape", [(24, 32), (48, 64), (50, 71)])
def test_forms_of_the_outcome(random, shape):
    level, before = (random.uniform(0, 9, size).astype(np.float32) for size in (shape, SHAPE))
    axial = np.linspace(1.3, 0.1, 10).astype(np.float32)
    level_of = np.linspace(9, 0, ENTRIES).astype(np.float32)
    density = np.float32((ENTRIES - 1) / 1.2)
    ends = np.float32(0.1), density
    tables = axial, np.full(10, 0.13, np.float32), level_of, PUBLISHED, ends
    fused = belief(random)
    own = (fused[0] * random.uniform(0.9, 1.1, SHAPE)).astype(np.float32)
    small, large = [], []
    all_forms = zip(forms(outcome.translate), forms(outcome.enlarge), strict=True)
    for translate, enlarge in all_forms:
        small.append((*np.empty((3, *SHAPE), np.float32), np.empty(SHAPE, np.bool_)))
        translate(before, own, fused, tables, small[-1])
        large.append(tuple(np.empty((3, *shape), np.float32)))
        enlarge(level, before, small[0], large[-1])
    assert 0 < small[0][3].mean() < 1
    assert_alike(small, atol=2e-3)
    assert_alike(large)
