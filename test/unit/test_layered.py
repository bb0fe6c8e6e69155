"""Random scenes of layers: the light that a lens lets through, and the truth behind it."""

import json
import sys

import cv2
import numpy as np
import pytest
from scipy import ndimage, signal

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, render_psf
from coded_aperture_ros.optics.mask import MASK_NAMES
from coded_aperture_ros.simulation import layered
from coded_aperture_ros.simulation.layered import SIDES, random_scene, rod_scene
from coded_aperture_ros.simulation.layered.tracing import (
    FINENESS,
    Layer,
    lens_samples,
    prefiltered,
    seen_from_centre,
    traced,
)

SHAPE = (48, 57)
MARGIN = 12
CANVAS = tuple(FINENESS * (length + 2 * MARGIN) for length in SHAPE)
PINHOLE = np.array([[0, 0, 1]], np.float32)


@pytest.fixture(autouse=True)
def numba(request):
    if "without_numba" not in request.node.name:
        pytest.importorskip("numba", reason="random scenes need numba")


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def texture(seed, mean=0.2, coarseness=4.0):
    noise = np.random.default_rng(seed).standard_normal(CANVAS).astype(np.float32)
    noise = ndimage.gaussian_filter(noise, coarseness)
    return np.clip(mean * (1 + 0.5 * noise / noise.std()), 0.01, 0.9)


def surface(blur_px, seed=0, matte=None, slope=(0.0, 0.0), relief=None, mean=0.2):
    """A layer that fills the canvas, or as much of it as the matte says."""
    matte = np.ones(CANVAS, np.float32) if matte is None else matte
    light = prefiltered(texture(seed, mean) * matte)
    plane = (blur_px, *slope)
    return Layer(-MARGIN, -MARGIN, light, prefiltered(matte), plane, relief)


def ellipse_and_rod():
    matte = np.zeros(CANVAS, np.float32)
    middle = CANVAS[1] // 2, CANVAS[0] // 2
    cv2.ellipse(matte, middle, (45, 28), 20, 0, 360, 1.0, -1)
    cv2.rectangle(matte, (0, 70), (75, 82), 1.0, -1)
    return matte


def arrival(layer, y, x, v, u):
    """Where rays through (v, u) arrive, on the canvas: by iterating until nothing moves."""
    base, down, right = layer.blur_px
    p, q = y, x
    for _ in range(12 if down or right or layer.relief_px is not None else 1):
        size = base + down * p + right * q
        if layer.relief_px is not None:
            at = [(p + MARGIN) * FINENESS, (q + MARGIN) * FINENESS]
            size = size + ndimage.map_coordinates(layer.relief_px, at, order=0, mode="nearest")
        p, q = y - v * size, x - u * size
    return [(p + MARGIN) * FINENESS, (q + MARGIN) * FINENESS]


def composite(layers, mask, widest_px):
    """The frame by another way: every opening a picture of its own, four times as many of them."""
    samples = lens_samples(mask, 4 * widest_px)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    frame = np.zeros(SHAPE)
    for v, u, weight in samples.astype(float):
        passed = np.ones(SHAPE)
        for layer in layers:
            at = arrival(layer, y, x, v, u)
            frame += weight * passed * ndimage.map_coordinates(layer.light, at, order=1)
            passed = passed * (1 - ndimage.map_coordinates(layer.cover, at, order=1))
    return frame


def coded(layers, mask, widest_px):
    return traced(list(layers), SHAPE, lens_samples(mask, widest_px))


def convolved(picture, psf):
    return signal.fftconvolve(picture, psf, "same")


def inside(values, margin=9):
    return values[margin:-margin, margin:-margin]


# --- light ---


@pytest.mark.parametrize("name", ["levin", "zhou", "three_hole", "disc", "mura"])
@pytest.mark.parametrize("blur_px", [-15.4, -6.3, 8.2, 15.4])
def test_a_plane_is_convolved_with_the_psf(name, blur_px):
    """Mask as stored beyond the focal plane, turned around in front of it."""
    layer, mask = surface(blur_px), Mask.named(name)
    frame = coded([layer], mask, abs(blur_px))
    sharp = traced([layer], SHAPE, PINHOLE)

    def misfit(factor):
        return rms(inside(convolved(sharp, render_psf(mask, factor * blur_px)) - frame))

    # A PSF that is rendered over pixels brings one box more than light through points does.
    assert misfit(1) < 0.0014
    assert misfit(0.9) > 3 * misfit(1) and misfit(1.1) > 3 * misfit(1)
    if mask.asymmetry > 0.1:
        assert misfit(-1) > 8 * misfit(1)


@pytest.mark.parametrize(
    ("name", "sizes_px"),
    [
        ("levin", (10.6, 15.6)),
        ("levin", (-9.0, 7.0)),
        ("zhou", (3.0, 12.0)),
        ("zhou", (-11.0, -5.0)),
        ("disc", (5.0, 9.0)),
    ],
)
def test_an_occlusion_edge_is_exact(name, sizes_px):
    mask, matte = Mask.named(name), ellipse_and_rod()
    near, far = (surface(size, seed) for seed, size in enumerate(sizes_px))
    near = surface(sizes_px[0], 0, matte, mean=0.12)
    widest = max(map(abs, sizes_px))
    frame = coded([near, far], mask, widest)
    assert rms(frame - composite([near, far], mask, widest)) < 0.0005

    # What is hidden from the middle of the lens, but not from all of it, matters a lot.
    cover = traced([surface(0, 0, matte)], SHAPE, PINHOLE) > 0
    sharp = [traced([layer], SHAPE, PINHOLE) for layer in (near, far)]
    added = sum(
        convolved(part, render_psf(mask, size))
        for part, size in zip((cover * sharp[0], ~cover * sharp[1]), sizes_px, strict=True)
    )
    assert rms(inside(added - frame)) > 0.01


def test_pixels_are_areas_and_not_points():
    """Against 5 x 5 rays a pixel, that see the canvas as it was drawn."""
    mask, matte = Mask.named("zhou"), ellipse_and_rod()
    sizes = (4.0, 8.0)
    frame = coded([surface(4.0, 1, matte), surface(8.0, 2)], mask, 8.0)
    fine = (np.arange(5) - 2) / 5
    y, x = ((np.arange(length)[:, None] + fine).ravel() for length in SHAPE)
    y, x = np.meshgrid(y, x, indexing="ij")
    light = np.zeros(y.shape)

    textures = [texture(1), texture(2)]
    for v, u, weight in lens_samples(mask, 16.0).astype(float):
        rays = [((y - v * s + MARGIN) * FINENESS, (x - u * s + MARGIN) * FINENESS) for s in sizes]
        # The mean over two canvas pixels lies between them.
        near, far = (np.add(at, 0.5) for at in rays)
        front = ndimage.map_coordinates(matte, near, order=0) > 0.5
        one, two = (
            ndimage.map_coordinates(canvas, at, order=1)
            for canvas, at in zip(textures, (near, far), strict=True)
        )
        light += weight * np.where(front, one, two)
    pixels = light.reshape(SHAPE[0], 5, SHAPE[1], 5).mean(axis=(1, 3))
    assert rms(frame - pixels) < 0.0008


@pytest.mark.parametrize("slope", [(0.08, 0.0), (0.0, -0.07), (-0.05, 0.06)])
def test_a_slanted_plane_has_blur_sizes_that_are_linear(slope):
    middle = 9.0 - slope[0] * SHAPE[0] / 2 - slope[1] * SHAPE[1] / 2
    layer, mask = surface(middle, slope=slope), Mask.named("zhou")
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sizes = middle + slope[0] * y + slope[1] * x
    np.testing.assert_allclose(seen_from_centre([layer], SHAPE), sizes, atol=1e-5)
    frame = coded([layer], mask, sizes.max())
    assert rms(frame - composite([layer], mask, sizes.max())) < 0.0005
    flat = composite([surface(9.0)], mask, 9.0)
    assert rms(frame - flat) > 0.003


def test_relief_bends_the_light_and_the_truth():
    y, x = np.mgrid[: CANVAS[0], : CANVAS[1]].astype(np.float32)
    relief = -2.5 * np.exp(-((y - CANVAS[0] / 2) ** 2 + (x - CANVAS[1] / 2) ** 2) / 600)
    layer, mask = surface(11.0, relief=relief.astype(np.float32)), Mask.named("levin")
    truth = seen_from_centre([layer], SHAPE)
    corner = FINENESS * MARGIN
    np.testing.assert_allclose(truth, 11 + relief[corner::2, corner::2][: SHAPE[0], : SHAPE[1]])
    assert truth.min() < 8.6
    frame = coded([layer], mask, 11.0)
    assert rms(frame - composite([layer], mask, 11.0)) < 0.0006
    assert rms(frame - coded([surface(11.0)], mask, 11.0)) > 0.002


@pytest.mark.parametrize("name", [*MASK_NAMES, "wide", "fine"])
def test_lens_samples_keep_the_light_and_the_middle_of_a_mask(name):
    shape = {"wide": (5, 9), "fine": (61, 33)}.get(name)
    drawn = np.random.default_rng(2).random(shape or 1) < 0.4
    mask = Mask(name, drawn.astype(np.float32)) if shape else Mask.named(name)
    cells = mask.transmission.astype(float)
    side = max(cells.shape)
    for widest in (1.0, 7.0, 19.5):
        down, right, weight = lens_samples(mask, widest).T
        assert weight.sum() == pytest.approx(1, abs=1e-5)
        assert max(np.abs(down).max(), np.abs(right).max()) < 0.5
        for axis, found in enumerate((down, right)):
            places = (np.arange(cells.shape[axis]) + 0.5 - cells.shape[axis] / 2) / side
            mean = (cells.sum(axis=1 - axis) * places).sum() / cells.sum()
            assert (weight * found).sum() == pytest.approx(mean, abs=1e-3)


# --- truth ---


def test_truth_is_the_surface_in_front():
    matte = ellipse_and_rod()
    behind = np.zeros(CANVAS, np.float32)
    behind[:, CANVAS[1] // 2 :] = 1
    layers = [surface(4.0, 1, matte), surface(7.0, 2, behind), surface(12.0, 3)]
    truth = seen_from_centre(layers, SHAPE)
    covers = [
        prefiltered(part)[FINENESS * MARGIN :, FINENESS * MARGIN :] for part in (matte, behind)
    ]
    first, second = (part[::2, ::2][: SHAPE[0], : SHAPE[1]] > 0.49 for part in covers)
    np.testing.assert_array_equal(truth, np.where(first, 4.0, np.where(second, 7.0, 12.0)))
    assert {4.0, 7.0, 12.0} == set(np.unique(truth))
    # The other way round nothing but the wall is seen.
    assert (seen_from_centre(layers[::-1], SHAPE) == 12).all()


@pytest.mark.parametrize("side", SIDES)
def test_truth_is_known_everywhere_and_of_its_side(side):
    sizes = []
    for seed in range(1_000_000, 1_000_012):
        scene = random_scene(seed, Mask.named("levin"), side, (61, 95))
        blur, depth = scene.blur_size_px(), scene.depth_m()
        assert blur.shape == depth.shape == (61, 95) == scene.shape
        assert np.isfinite(blur).all() and np.isfinite(depth).all() and (depth > 0).all()
        np.testing.assert_allclose(scene.camera.blur_size_px(depth), blur, atol=2e-3)
        assert scene.camera.side == side
        beyond = depth > scene.camera.focus_distance_m
        np.testing.assert_array_equal(beyond, blur > 0)
        sizes.append(blur)
    found = np.array(sizes)
    assert (found.min() < -3) == (side != "far") and (found.max() > 3) == (side != "near")
    assert np.abs(found).max() < 20


def test_all_in_focus_and_truth_lie_on_each_other():
    """Where the truth jumps, the picture through the middle of the lens has its outlines."""
    matte = ellipse_and_rod()
    layers = [
        Layer(-MARGIN, -MARGIN, prefiltered(0.1 * matte), prefiltered(matte), (4.0, 0.0, 0.0)),
        Layer(-MARGIN, -MARGIN, np.full(CANVAS, 0.7), np.ones(CANVAS), (12.0, 0.0, 0.0)),
    ]
    in_front = seen_from_centre(layers, SHAPE) == 4
    picture = traced(layers, SHAPE, PINHOLE)
    np.testing.assert_array_equal(picture < 0.404, in_front)
    assert 0.1 < in_front.mean() < 0.6


# --- random scenes ---


@pytest.mark.parametrize("name", MASK_NAMES)
def test_every_mask_and_side_makes_a_frame(name):
    mask = Mask.named(name)
    for number, side in enumerate(SIDES):
        scene = random_scene(1_000_020 + number, mask, side, (75 + number, 91))
        frame, sharp = scene.coded(), scene.all_in_focus()
        assert frame.shape == sharp.shape == (75 + number, 91)
        assert frame.dtype == sharp.dtype == np.float32
        assert frame.min() > 0 and max(frame.max(), sharp.max()) <= 0.9 + 1e-4
        assert frame.mean() == pytest.approx(sharp.mean(), rel=0.1)
        assert rms(frame - sharp) > 0.002


def test_the_seed_decides():
    def made(seed, side="both", mask="zhou"):
        scene = random_scene(seed, Mask.named(mask), side, (64, 80))
        return scene.coded(), scene.blur_size_px()

    for one, two in zip(made(7), made(7), strict=True):
        np.testing.assert_array_equal(one, two)
    for other in (made(8), made(7, side="far")):
        assert (other[0] != made(7)[0]).mean() > 0.9
    # Another mask sees the same scene.
    levin = made(7, mask="levin")
    np.testing.assert_array_equal(levin[1], made(7)[1])
    assert rms(levin[0] - made(7)[0]) > 0.001


@pytest.mark.parametrize("side", SIDES)
def test_rods_are_as_wide_as_they_should_be(side):
    widths = (2.0, 3.5, 6.0, 9.5, 20.0)
    scene, labels = rod_scene(5, Mask.named("zhou"), widths, side, (150, 241))
    assert set(np.unique(labels)) == set(range(len(widths) + 1))
    blur, sharp = scene.blur_size_px(), scene.all_in_focus()
    room = seen_from_centre(list(scene.layers[len(widths) :]), scene.shape)
    lying = (labels == 5).any(axis=0).all()
    for label, width in enumerate(widths, 1):
        here = labels == label
        length = np.count_nonzero(here.any(axis=0 if lying else 1))
        # Rods lean a little, and then they are wider along a row.
        assert here.sum() / length == pytest.approx(width, rel=0.1, abs=0.1)
        assert (blur[here] <= room[here]).mean() > 0.7
        assert sharp[here].std() > 0
    np.testing.assert_array_equal(blur[labels == 0], room[labels == 0])
    again, _ = rod_scene(5, Mask.named("zhou"), widths, side, (150, 241))
    np.testing.assert_array_equal(again.coded(), scene.coded())


def test_another_mask_can_be_held_before_a_scene():
    scene = random_scene(3, Mask.named("levin"), "far", (64, 80))
    disc = random_scene(3, Mask.named("disc"), "far", (64, 80))
    np.testing.assert_array_equal(scene.coded(Mask.named("disc")), disc.coded())


def test_without_numba_random_scenes_say_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, f"{layered.__name__}.kernels", raising=False)
    monkeypatch.delattr(layered, "kernels", raising=False)
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(InputError, match="pip install numba"):
        traced([surface(5.0)], SHAPE, PINHOLE)


# --- ray-traced pictures ---


@pytest.mark.parametrize("name", ["levin", "zhou"])
def test_a_ray_traced_wall_is_the_same(name, data_dir):
    """The back wall of `room`, 5 m away, from its all-in-focus picture."""
    folder = data_dir / "rendered_more" / "room"
    if not folder.is_dir():
        pytest.skip("needs rendered_more/room")
    about = json.loads((folder / "meta.json").read_text())
    cells = [[cell == "#" for cell in row] for row in about["masks"][name]]
    mask = Mask(name, np.array(cells, np.float32))

    def picture(file):
        return cv2.imread(str(folder / file), -1)[..., ::-1].mean(axis=2) / 65520

    depth = cv2.imread(str(folder / "depth_0.1mm.png"), -1) * 1e-4
    wall = ndimage.binary_erosion(np.abs(depth - 5) < 0.002, np.ones((3, 3)), 12)
    focus = about["focus_distance_m"]
    size = about["aperture_width_m"] * about["fx"] * (1 / focus - 1 / 5)
    sharp = picture("aif_linear.png").astype(np.float32)
    places = np.mgrid[: 2 * len(sharp), : 2 * sharp.shape[1]] / FINENESS
    canvas = ndimage.map_coordinates(sharp, places, order=3, mode="nearest").astype(np.float32)
    stored = picture(f"coded_{name}_linear.png")

    def misfit(factor):
        plane = Layer(0, 0, canvas, np.ones_like(canvas), (factor * size, 0.0, 0.0))
        frame = traced([plane], sharp.shape, lens_samples(mask, 17.2))
        return rms((frame - stored)[wall])

    assert wall.sum() > 1000
    assert misfit(1) < 0.0011
    assert misfit(0.9) > 3 * misfit(1) and misfit(1.1) > 3 * misfit(1)
