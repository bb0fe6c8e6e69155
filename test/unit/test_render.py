import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage, signal

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, render_psf
from coded_aperture_ros.simulation import SensorModel, render_coded_frame
from coded_aperture_ros.simulation.hidden import Surface, fill_unknown, hidden_surface

NEAR_EDGE_PX = 16


def camera(mask="levin", side="far"):
    return Camera(
        focal_length_px=800,
        focus_distance_m=0.9,
        image_width=96,
        image_height=80,
        mask=Mask.named(mask),
        mask_extent_mm=25,
        side=side,
    )


def texture(height=80, width=96, seed=0):
    noise = np.random.default_rng(seed).random((height, width, 3), dtype=np.float32)
    return ndimage.gaussian_filter(noise, (1, 1, 0))


def convolved(image, psf):
    """The image convolved with a PSF, edges replicated, by another library than the renderer's."""
    reach = len(psf) // 2
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    return np.stack([signal.convolve2d(padded[..., c], psf, "valid") for c in range(3)], axis=-1)


@pytest.mark.parametrize("mask", ["levin", "zhou", "three_hole", "disc"])
@pytest.mark.parametrize("depth", [0.6, 0.9, 1.3, 2.5])
@pytest.mark.parametrize("blocks", [1, 3])
def test_a_plane_is_convolved_exactly(mask, depth, blocks):
    image = texture()
    rendered = render_coded_frame(
        image, np.full((80, 96), depth), camera(mask), aperture_blocks=blocks
    )
    psf = render_psf(Mask.named(mask), float(camera(mask).blur_size_px(depth)))
    assert rendered.dtype == np.float32
    assert rendered == pytest.approx(convolved(image, psf), abs=3e-6)


def test_grey_and_colour_agree():
    image, depth = texture(), np.tile(np.linspace(1, 2, 96), (80, 1))
    colour = render_coded_frame(image, depth, camera())
    grey = render_coded_frame(image[..., 1], depth, camera())
    assert grey.shape == (80, 96)
    assert grey == pytest.approx(colour[..., 1], abs=1e-6)


# Here no known surface sends light to some pixels through some blocks of the aperture.
@example(near=2.0, far=0.5, blocks=2)
@example(near=2.0, far=0.5, blocks=3)
@given(near=st.floats(0.5, 2.0), far=st.floats(0.5, 4.0), blocks=st.integers(1, 3))
@settings(max_examples=15, deadline=None)
def test_no_seams_in_a_white_scene(near, far, blocks):
    # Whatever the geometry, a white scene stays white: no light is lost or counted twice.
    rows, columns = np.indices((48, 64))
    depth = near + (far - near) * rows / 48
    depth[(columns // 16) % 2 == 0] *= 1.4
    rendered = render_coded_frame(np.ones((48, 64)), depth, camera("zhou"), aperture_blocks=blocks)
    assert rendered == pytest.approx(np.ones((48, 64)), abs=1e-4)


def test_slanted_surface_has_each_pixel_s_own_blur():
    image = texture(96, 96)
    depth = 1 / np.linspace(1 / 1.1, 1 / 2.2, 96)[:, None].repeat(96, axis=1)
    rendered = render_coded_frame(image, depth, camera())
    sizes = camera().blur_size_px(depth[:, 0])
    for row in (30, 50, 70):
        psf = render_psf(Mask.named("levin"), sizes[row])
        error = rendered[row, 12:-12] - convolved(image, psf)[row, 12:-12]
        wrong = (
            rendered[row, 12:-12] - convolved(image, render_psf(camera().mask, 3.0))[row, 12:-12]
        )
        assert np.sqrt((error**2).mean()) < 0.1 * np.sqrt((wrong**2).mean())


def ray_traced(foreground, background, edge, near_px, far_px, mask, width):
    """One row of a half plane in front of a plane, traced through every cell of the mask."""
    cells = len(mask.transmission)
    samples = 40
    x = np.arange(width)
    result = np.zeros(width)
    for column in range(cells):
        weight = mask.transmission[:, column].sum() / mask.transmission.sum() / samples
        for part in range(samples):
            a = (column + (part + 0.5) / samples) / cells - 0.5
            hit = x - near_px * a
            front = np.interp(hit, x, foreground)
            # A pixel's square is covered by the more, the farther the edge is across it.
            covered = np.clip(edge + 0.5 - hit, 0, 1)
            back = np.interp(x - far_px * a, x, background)
            result += weight * (covered * front + (1 - covered) * back)
    return result


@pytest.mark.parametrize(("near_m", "far_m"), [(0.95, 2.5), (1.2, 2.0), (0.6, 0.8), (0.75, 1.3)])
@pytest.mark.parametrize("mask", ["levin", "zhou"])
def test_occluding_edge_agrees_with_rays(near_m, far_m, mask):
    cam = camera(mask)
    width, edge = 120, 60
    foreground = 0.2 + 0.1 * np.sin(np.arange(width) / 5)
    background = np.full(width, 0.8)
    columns = np.arange(width)
    row = np.where(columns < edge, foreground, background)
    depth = np.where(columns < edge, near_m, far_m)
    rendered = render_coded_frame(np.tile(row, (40, 1)), np.tile(depth, (40, 1)), cam)[20]
    near_px, far_px = cam.blur_size_px([near_m, far_m])
    # Pixel edge - 1 is the last of the foreground, which ends half a pixel further on.
    expected = ray_traced(foreground, background, edge - 0.5, near_px, far_px, cam.mask, width)
    assert rendered[20:-20] == pytest.approx(expected[20:-20], abs=0.03)
    assert np.abs(rendered - expected)[20:-20].mean() < 0.004


def test_background_shows_no_foreground_colour_beyond_a_sharp_edge():
    # The foreground is in focus: its edge stays where it is, and nothing of it leaks outwards.
    image = np.zeros((60, 80, 3), np.float32)
    image[:, :40, 0] = 1
    image[:, 40:, 2] = 1
    depth = np.full((60, 80), 2.5)
    depth[:, :40] = 0.9
    rendered = render_coded_frame(image, depth, camera())
    assert rendered[:, 41:, 0].max() < 1e-5
    assert rendered[:, :39] == pytest.approx(image[:, :39], abs=1e-5)
    assert rendered[:, 41:, 2] == pytest.approx(np.ones((60, 39)), abs=1e-4)


def test_unknown_depth_is_taken_from_the_farther_neighbour():
    depth = np.array([[1, np.nan, np.nan, 3], [1, 1, np.nan, np.nan], [np.nan] * 4], np.float32)
    assert fill_unknown(depth).tolist() == [[1, 3, 3, 3], [1, 1, 1, 1], [1, 1, 1, 1]]
    holes = np.full((80, 96), 2.0)
    holes[20:40, 30:60] = np.nan
    rendered = render_coded_frame(texture(), holes, camera())
    whole = render_coded_frame(texture(), np.full((80, 96), 2.0), camera())
    assert rendered == pytest.approx(whole, abs=1e-5)


def test_hidden_surface_continues_the_farther_one_as_far_as_light_reaches():
    front = np.full((5, 20), 10.0, np.float32)
    front[:, 8:] = 2.0
    colours = np.zeros((5, 20, 1), np.float32)
    colours[:, :8] = 0.7
    hidden = hidden_surface(Surface(front, colours), 1.5, 4)
    assert (hidden.blur_size_px[:, 8:12] == 10).all()
    assert hidden.colours[:, 8:12] == pytest.approx(0.7)
    assert np.isnan(hidden.blur_size_px[:, :8]).all()
    assert np.isnan(hidden.blur_size_px[:, 12:]).all()


@pytest.mark.parametrize(
    ("image", "depth", "reason"),
    [
        (np.ones((4, 5)), np.ones((5, 4)), "of one size"),
        (np.full((4, 4), np.nan), np.ones((4, 4)), "image: all pixels must be finite"),
        (np.ones((4, 4)), np.full((4, 4), np.nan), "no pixel has a known depth"),
        (np.ones((4, 4)), np.full((4, 4), -1.0), "more than 0 m"),
        (np.ones((4, 4)), np.full((4, 4), 1e-3), "too near the lens"),
        (np.ones((0, 4)), np.ones((0, 4)), "of one size"),
    ],
)
def test_unusable_scene_is_refused(image, depth, reason):
    with pytest.raises(InputError, match=reason):
        render_coded_frame(image, depth, camera())


@pytest.mark.parametrize(
    ("options", "reason"),
    [({"layer_spacing_px": 0}, "layer spacing"), ({"aperture_blocks": 0}, "aperture blocks")],
)
def test_impossible_rendering_options_are_refused(options, reason):
    with pytest.raises(InputError, match=reason):
        render_coded_frame(np.ones((4, 4)), np.ones((4, 4)), camera(), **options)


# Measured: desk 0.0019 / 0.0031, corridor 0.0014 / 0.0023 (see docs/experiments.md).
@pytest.mark.parametrize("scene", ["desk", "corridor"])
def test_agrees_with_ray_traced_photographs(data_dir, scene):
    traced = RayTracedScene.load(data_dir / "rendered" / scene, "levin")
    rendered = render_coded_frame(traced.sharp, traced.depth_m, traced.camera)
    near = traced.edge_distance_px() <= NEAR_EDGE_PX
    inside = np.zeros(near.shape, bool)  # the simulator does not know what is beyond the border
    inside[NEAR_EDGE_PX:-NEAR_EDGE_PX, NEAR_EDGE_PX:-NEAR_EDGE_PX] = True

    def rms(picture, where):
        return np.sqrt(np.mean((picture - traced.coded)[where] ** 2))

    assert rms(rendered, inside & ~near) < 0.0022
    assert rms(rendered, inside & near) < 0.0036
    everywhere = np.ones(near.shape, bool)
    assert rms(rendered, everywhere) < 0.15 * rms(traced.sharp, everywhere)


def test_sensor_noise_has_its_standard_deviation_and_seed():
    flat = np.full((200, 200), 0.5)
    exposed = SensorModel(noise=0.01).expose(flat, np.random.default_rng(1))
    assert exposed.dtype == np.float32
    assert exposed.std() == pytest.approx(0.01, rel=0.03)
    assert exposed.mean() == pytest.approx(0.5, abs=2e-4)
    assert np.array_equal(exposed, SensorModel(0.01).expose(flat, np.random.default_rng(1)))
    assert (flat == 0.5).all()


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_quantisation_rounds_to_steps_and_clips(bits):
    exposed = SensorModel(bits=bits).expose(np.linspace(-0.1, 1.1, 99), np.random.default_rng(0))
    steps = exposed.astype(np.float64) * (2**bits - 1)
    assert steps == pytest.approx(np.rint(steps), abs=1e-2)
    assert (exposed.min(), exposed.max()) == (0, 1)


@pytest.mark.parametrize("options", [{"noise": -1}, {"noise": np.nan}, {"bits": 10}])
def test_impossible_sensor_is_refused(options):
    with pytest.raises(InputError, match="expected 0"):
        SensorModel(**options)


def test_supersampled_light_is_blurred_before_pixels_take_its_mean():
    """On a plane: the PSF at twice the pixels, and the mean of the samples of each pixel."""
    sharp, depth_m = texture(), np.full((80, 96), 2.5)
    found = render_coded_frame(sharp, depth_m, camera(), supersampling=2)
    psf = render_psf(Mask.named("levin"), 2 * float(camera().blur_size_px(2.5)))
    fine = convolved(sharp, psf).reshape(40, 2, 48, 2, 3)
    assert found == pytest.approx(fine.mean(axis=(1, 3)), abs=3e-6)


@pytest.mark.parametrize("supersampling", [0, 3])
def test_samples_fill_whole_pixels(supersampling):
    depth_m = np.full((80, 96), 2.5)
    with pytest.raises(InputError, match="supersampling: expected a divisor"):
        render_coded_frame(texture(), depth_m, camera(), supersampling=supersampling)
