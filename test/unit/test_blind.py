"""Finding an unknown mask from planes at unknown distances."""

import contextlib
import dataclasses
import json

import numpy as np
import pytest
from blind_scene import CONFIG, MASK, SIZES_PX, names, plane, planes
from cli_scene import call, call_benchmarks, examples, wrong_usage
from coded_aperture_benchmarks.datasets.blind_planes import (
    deblurring_loss,
    make_blind_planes,
    mask_correlation,
)
from coded_aperture_benchmarks.datasets.textures import load_textures

from coded_aperture_ros.calibration.blind.config import BlindConfig
from coded_aperture_ros.calibration.blind.find import BlindMask, find_mask
from coded_aperture_ros.calibration.blind.grid_misfit import (
    FoundSpectra,
    GridMisfit,
    best_grid,
    improved,
)
from coded_aperture_ros.calibration.blind.relative_sizes import relative_blur_sizes
from coded_aperture_ros.calibration.mask.fit import MaskFit
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.sizes import FreeSizes
from coded_aperture_ros.calibration.mask.spectra import half_plane, mean_by_contrast, window_powers
from coded_aperture_ros.calibration.pictures import blind_picture
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.scores.crops import Textures
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.likelihood.bank import WindowedFourierBasis, load_bank
from coded_aperture_ros.optics import Mask

CELLS = MASK.transmission.astype(np.float64)
SMALL = ("--largest-blur-px", 14, "--least-cells", 5, "--most-cells", 5)
FILTERS = ("--window-px", 24, "--rank", 16, "--level-count", 5)


@pytest.fixture(scope="module")
def pictures():
    return planes()


@pytest.fixture(scope="module")
def found(pictures):
    return find_mask(pictures, names(), CONFIG)


@pytest.fixture(scope="module")
def misfit(pictures):
    """The misfit of grids as large as the mask, around the spectra of the true one."""
    fourier = WindowedFourierBasis(CONFIG.window_px, 0.4)
    means = [mean_by_contrast(window_powers(image, fourier), fourier) for image in pictures]
    likelihood = MaskLikelihood(means, fourier, 14)
    sizes = FreeSizes(SIZES_PX, 14)
    fit = MaskFit(CELLS[None] / CELLS.sum(), sizes, likelihood.first_log_noise)
    fit = fit.optimise(likelihood, 20, masks=False)
    return GridMisfit(likelihood, FoundSpectra.from_fit(fit, likelihood), 5, SIZES_PX / 5)


def turned_alike(cells, true):
    return np.array_equal(cells, true) or np.array_equal(cells[::-1, ::-1], true)


def test_mask_and_blur_sizes_are_found(found):
    assert turned_alike(found.mask.transmission, MASK.transmission)
    assert found.blur_sizes_px == pytest.approx(SIZES_PX, rel=0.025)
    assert found.explained > 0.85
    assert not found.reaches_limit
    assert not found.doubtful


@pytest.mark.slow
def test_a_mask_that_the_grids_cannot_show_is_doubtful(pictures):
    config = dataclasses.replace(CONFIG, least_cells=7, most_cells=7)
    assert find_mask(pictures, names(), config).doubtful
    config = dataclasses.replace(CONFIG, least_cells=4, most_cells=4)
    # How the processor's BLAS rounds decides which grid the search ends with: refused or doubtful.
    with contextlib.suppress(InputError):
        assert find_mask(pictures, names(), config).doubtful
    config = dataclasses.replace(CONFIG, least_cells=3, most_cells=3)
    with pytest.raises(InputError, match="no mask pattern in the spectra"):
        find_mask(pictures, names(), config)


def test_the_picture_shows_the_mask_and_every_spectrum(found):
    drawn = blind_picture(found)
    assert (drawn.dtype, drawn.shape) == (np.float32, (402, 996))
    assert np.array_equal(samples(drawn[6:198, 6:198], 5), found.mask.transmission)
    # Measured to the left, explained to the right, each the mirror image of the other half.
    spectrum = samples(drawn[6:198, 204:396], CONFIG.window_px)
    turned = spectrum[:0:-1, ::-1]
    assert np.corrcoef(spectrum[1:].ravel(), turned.ravel())[0, 1] > 0.95
    assert not np.array_equal(spectrum[1:], turned)


def samples(tile, count):
    """Return what a tile shows in the middle of each of so many squares a side."""
    centres = ((np.arange(count) + 0.5) * len(tile) / count).astype(int)
    return tile[np.ix_(centres, centres)]


def test_spectra_tell_how_much_more_one_plane_is_blurred(pictures):
    sizes = relative_blur_sizes(pictures, names(), 2 * CONFIG.window_px)
    assert sizes.max() == 1
    assert np.array_equal(np.argsort(sizes), np.argsort(SIZES_PX))
    assert sizes == pytest.approx(SIZES_PX / SIZES_PX.max(), rel=0.25)


def test_periodograms_of_white_noise_have_its_variance():
    white = np.random.default_rng(0).normal(0.5, 0.1, (120, 130)).astype(np.float32)
    fourier = WindowedFourierBasis(16)
    powers = window_powers(white, fourier)
    assert len(powers) == 27 * 29
    counts = fourier.multiplicity > 0
    assert powers[:, counts].mean() == pytest.approx(0.01, rel=0.03)
    first = white[:16, 1:17] * np.outer(fourier.window, fourier.window)
    expected = np.abs(np.fft.rfft2(first)).ravel() ** 2
    np.testing.assert_allclose(powers[0], expected, rtol=1e-3, atol=1e-6)
    means = mean_by_contrast(powers, fourier)
    assert means.shape == (3, fourier.size)
    contrast = means @ fourier.multiplicity
    assert contrast[0] < contrast[1] < contrast[2]


def test_the_true_grid_has_the_least_misfit(misfit):
    assert np.array_equal(misfit.lags, half_plane(4))
    least = misfit.value(CELLS)
    assert misfit.value(CELLS[::-1, ::-1]) == pytest.approx(least)
    assert misfit.flip_values(CELLS).min() > least
    random = np.random.default_rng(1)
    for _ in range(20):
        assert misfit.value(random.integers(0, 2, (5, 5)) + np.eye(5)) > least


def test_misfit_of_flips_and_its_gradient(misfit):
    grid = np.random.default_rng(2).integers(0, 2, (5, 5)).astype(float)
    flips = misfit.flip_values(grid)
    for cell in (0, 7, 24):
        flipped = grid.copy()
        flipped.flat[cell] = 1 - flipped.flat[cell]
        assert flips[cell] == pytest.approx(misfit.value(flipped), rel=1e-6)
    grey = np.random.default_rng(3).random(25)
    value, gradient = misfit.value_and_gradient(grey)
    assert value == pytest.approx(misfit.value(grey.reshape(5, 5)), rel=1e-9)
    for cell in (3, 12):
        step = np.zeros(25)
        step[cell] = 1e-5
        ends = [misfit.value((grey + sign * step).reshape(5, 5)) for sign in (1, -1)]
        assert gradient[cell] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3)


def test_the_search_finds_the_grid_from_random_starts(misfit):
    best = best_grid(misfit, 6, np.random.default_rng(0))
    assert turned_alike(best.cells, CELLS)
    wrong = CELLS.copy()
    wrong[0, 0], wrong[2, 2] = 0, 1
    assert turned_alike(improved(misfit, wrong, np.random.default_rng(0)).cells, CELLS)


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (lambda images: images[:3], "3 planes are too few"),
        (lambda images: [image[:50, :50] for image in images], "50x50 px are too few for blur"),
        (lambda images: [*images[:5], images[5][:200]], "5.png: 208x200 px, but 0.png has 208x208"),
        (lambda images: [*images[:5], 0 * images[5] + 0.5], "5.png: contrast 0 is not above"),
        (
            lambda images: [*images[:5], 0 * images[5] + 1],
            "5.png: 100% of the pixels are saturated",
        ),
        (lambda images: [*images[:5], plane(0, 9)], "5.png: its spectrum has nothing in common"),
        (lambda _: [plane(8, seed) for seed in range(6)], "all planes are blurred alike"),
    ],
)
def test_planes_that_are_no_use_are_refused(pictures, change, phrase):
    images = change(pictures)
    with pytest.raises(InputError, match=phrase):
        find_mask(images, names(len(images)), CONFIG)


def test_an_aperture_without_a_pattern_is_no_mask():
    open_square = planes(mask=Mask.from_rows(["#"]))
    config = dataclasses.replace(CONFIG, most_cells=4)
    with pytest.raises(InputError, match="only an open rectangle"):
        find_mask(open_square, names(), config)


def test_settings_that_cannot_be():
    with pytest.raises(InputError, match="least_cells: 9 is more than most_cells, 8"):
        BlindConfig(least_cells=9, most_cells=8)
    with pytest.raises(InputError, match="largest_blur_px: 65 is out of range"):
        BlindConfig(largest_blur_px=65)


def test_correlation_does_not_mind_the_orientation():
    assert mask_correlation(MASK, MASK) == pytest.approx(1)
    turned = Mask("turned", MASK.transmission[::-1, ::-1])
    assert mask_correlation(turned, MASK) == pytest.approx(1)
    assert mask_correlation(Mask("mirrored", MASK.transmission[:, ::-1]), MASK) < 0.9
    # As wide as the truth, but not as high.
    assert mask_correlation(Mask("cut", MASK.transmission[:4]), MASK) < 0.9


@pytest.fixture(scope="module")
def blind_planes():
    textures = load_textures("natural")
    return make_blind_planes(Mask.named("zhou"), textures, 0.001, 3, 4, (128, 160))


def test_planes_to_be_found(blind_planes):
    assert blind_planes.coded.shape == blind_planes.sharp.shape == (4, 128, 160)
    assert sorted(blind_planes.blur_sizes_px) == pytest.approx(np.linspace(7, 30, 4))
    steps = blind_planes.coded * 255
    assert steps == pytest.approx(np.rint(steps), abs=1e-3)
    other = make_blind_planes(
        Mask.named("levin"), load_textures("natural"), 0.001, 3, 4, (128, 160)
    )
    assert np.array_equal(other.sharp, blind_planes.sharp)
    assert np.array_equal(other.blur_sizes_px, blind_planes.blur_sizes_px)
    with pytest.raises(InputError, match="no picture has"):
        make_blind_planes(MASK, Textures("natural", ()), 0.001)


def test_what_deblurring_loses(blind_planes):
    zhou = blind_planes.mask
    turned = Mask("turned", zhou.transmission[::-1, ::-1])
    sizes = blind_planes.blur_sizes_px
    same = deblurring_loss(blind_planes, turned, sizes)
    assert same.found_db == pytest.approx(same.true_db, abs=0.01)
    assert same.largest_loss_db == pytest.approx(0, abs=0.01)
    wrong = deblurring_loss(blind_planes, Mask.named("levin"), sizes)
    assert wrong.true_db - wrong.found_db > 1
    assert wrong.largest_loss_db >= wrong.true_db - wrong.found_db


@pytest.fixture
def folder(pictures, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planes").mkdir()
    for name, image in zip(names(), pictures, strict=True):
        write_image(tmp_path / "planes" / name, image)
    return tmp_path


def test_from_a_folder_to_a_mask_and_a_bank(folder, capsys):
    given = ("calibrate", "blind", "planes", *SMALL, *FILTERS, "--output", "found")
    result = call(capsys, *given, "-o", "bank.npz", "--json")
    assert (result.status, result.err) == (0, "")
    summary = json.loads(result.out)
    mask = Mask.from_file("found/mask.npy")
    assert turned_alike(mask.transmission, MASK.transmission)
    assert summary["mask"] == ["".join(".#"[int(c)] for c in row) for row in mask.transmission]
    sizes = [row["blur_size_px"] for row in summary["planes"]]
    assert sizes == pytest.approx(SIZES_PX, rel=0.025)
    assert [row["file"] for row in summary["planes"]] == [f"planes/{name}" for name in names()]
    drawn = read_image("found/mask.png", 2.2)
    assert np.array_equal(drawn[51::102, 51::102] > 0.5, mask.transmission > 0.5)
    assert read_image("found/spectra.png", 2.2).shape == (402, 996)
    bank = load_bank("bank.npz")
    assert bank.stack.blur_sizes_px[[0, -1]] == pytest.approx([5, 12], rel=0.02)
    assert json.loads((folder / "found" / "calibrate_blind.json").read_text()) == summary
    deblur = ("deblur", "--bank", "bank.npz", "--depth", "auto", "planes/2.png", "-o", "sharp.png")
    assert call(capsys, *deblur).status == 0


@pytest.fixture
def known(monkeypatch):
    """Find at once what is true, but turned: for what is around the search."""

    def find(images, names, config=None, progress=iter):
        mask = Mask("found", Mask.named("levin").transmission[::-1, ::-1])
        spectra = np.random.default_rng(0).random((len(images), 2, 64, 33))
        sizes = np.linspace(7, 30, len(images))
        return BlindMask(mask, sizes, 0.9, spectra, reaches_limit=True, doubtful=True)

    for module in ("calibration.blind.find", "cli.calibrate_blind"):
        monkeypatch.setattr(f"coded_aperture_ros.{module}.find_mask", find)


@pytest.mark.slow
def test_the_examples_of_calibrate_blind(folder, capsys, known, caplog):
    for name in "abcd":
        write_image(f"{name}.png", read_image("planes/0.png"))
    lines = examples(capsys, "calibrate blind")
    assert len(lines) == 2
    for arguments in lines:
        result = call(capsys, *arguments)
        assert result.status == 0, result.err
        assert "mask of 11x11 cells" in result.out
        assert "turned by 180 degrees" in result.out
    assert "the blur is larger than 32 px" in caplog.text
    assert "this may not be the mask: try more --starts" in caplog.text


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (("planes",), "required: --output or -o (where the results go)"),
        (("planes", "-o", "bank.npz", "--level-count", 1), "--level-count: 1 is out of range"),
        (("planes", "--output", "x", "--least-cells", 9, "--most-cells", 8), "--least-cells: 9"),
        (("planes", "-o", "b.npz", "--window-px", 24), "does not fit patches of 24 px"),
    ],
)
def test_wrong_usage_of_calibrate_blind(folder, capsys, arguments, phrase):
    wrong_usage(call(capsys, "calibrate", "blind", *arguments), "calibrate blind", phrase)


@pytest.mark.slow
def test_bench_blind_compares_with_the_truth(tmp_path, capsys, monkeypatch, known):
    monkeypatch.chdir(tmp_path)
    size = ("--size", "160x128", "--planes", 4, "--jobs", 1)
    # The order of the planes is that of the seed; what is found has them in ascending order.
    seed = next(
        seed
        for seed in range(200)
        if np.all(
            np.diff(make_blind_planes(MASK, Textures("random", ()), 0, seed, 4).blur_sizes_px) > 0
        )
    )
    given = ("blind", "--masks", "levin", "--seed", seed, *size, "--output", "out")
    result = call_benchmarks(capsys, *given, "--json")
    assert (result.status, result.err) == (0, "")
    (row,) = json.loads(result.out)["masks"]
    assert (row["correlation"], row["cells"], row["largest_size_error"]) == (1, [11, 11], 0)
    for method in ("fast", "cg"):
        assert row[method]["largest_loss_db"] == pytest.approx(0, abs=0.01)
        assert row[method]["true_db"] > 15
    assert (tmp_path / "out" / f"levin_{seed}.png").is_file()
    table = call_benchmarks(capsys, *given).out
    assert "1.000  11x11" in table
    refuse = "coded_aperture_ros.calibration.blind.find.find_mask"
    monkeypatch.setattr(refuse, lambda *_: (_ for _ in ()).throw(InputError("no mask")))
    result = call_benchmarks(capsys, *given)
    assert (result.status, f"levin {seed}: no mask" in result.out) == (0, True)
