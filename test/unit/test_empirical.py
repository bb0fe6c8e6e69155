"""Textures learned from sharp images instead of assumed."""

import numpy as np
import pytest
from cli_scene import call, refused
from textures import blurred_texture

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import (
    EmpiricalPrior,
    LearnConfig,
    learn_bank,
    load_bank,
    power_spectrum,
    save_bank,
)
from coded_aperture_ros.optics import Mask, render_psf_stack

SIZES = np.linspace(3.0, 13.0, 9)


def texture(spectrum, seed=0, size=384, contrast=0.01):
    """Sharp texture of a given spectrum (a function of the shape)."""
    shape = (size, size)
    white = np.fft.rfft2(np.random.default_rng(seed).normal(size=shape))
    picture = np.fft.irfft2(white * np.sqrt(contrast * spectrum(shape)), shape)
    return (0.5 + picture).astype(np.float32)


def law(slope):
    return lambda shape: power_spectrum(slope, shape)


def weave(shape):
    """Spectrum with a band, as of cloth: no power law."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    power = (
        1 / np.maximum(frequency, 0.01) ** 2 * (0.05 + np.exp(-(((frequency - 0.2) / 0.05) ** 2)))
    )
    return power / np.fft.irfft2(power, shape)[0, 0]


def test_power_laws_are_learned_as_such():
    prior = EmpiricalPrior.from_images([texture(law(1.2)), texture(law(2.8), 1)], kinds=2)
    # Leakage and the few windows leave some error.
    assert prior.slopes == pytest.approx((1.2, 2.8), abs=0.2)
    assert np.abs(prior.deviations).max() < 0.4
    for spectrum, slope in zip(prior.spectra, (1.2, 2.8), strict=True):
        shape = (96, 80)
        power = spectrum(shape)
        assert np.fft.irfft2(power, shape)[0, 0] == pytest.approx(1)
        ratio = (power / power_spectrum(slope, shape))[3:40, 3:]
        assert np.abs(np.log(ratio / np.median(ratio))).max() < 0.6


def test_contrast_and_colour_do_not_matter():
    picture = texture(weave)
    coloured = np.stack([0.9 * picture, picture, 0.8 * picture], axis=-1)
    grey, colour = (EmpiricalPrior.from_images([image], kinds=1) for image in (picture, coloured))
    assert colour.slopes == pytest.approx(grey.slopes, abs=1e-3)
    assert colour.deviations[0] == pytest.approx(grey.deviations[0], abs=1e-3)


def test_levels_of_an_unusual_texture_are_found_where_power_laws_fail():
    stack = render_psf_stack(Mask.named("levin"), SIZES)
    config = LearnConfig(window_px=32)
    empirical = learn_bank(stack, config, EmpiricalPrior.from_images([texture(weave)], kinds=1))
    natural = learn_bank(stack, config)
    errors = {"empirical": [], "natural": []}
    for level in range(0, 9, 2):
        sharp = texture(weave, seed=level + 5)
        padded = np.zeros(sharp.shape)
        psf = stack.psfs[level]
        padded[: len(psf), : len(psf)] = psf
        image = np.fft.irfft2(np.fft.rfft2(sharp) * np.fft.rfft2(padded), sharp.shape)
        image += np.random.default_rng(level).normal(0, 0.01, image.shape)
        for name, bank in (("empirical", empirical), ("natural", natural)):
            energies = bank.energies(image.astype(np.float32), 16, 0.011)
            errors[name].append(np.abs(energies.argmin(axis=-1) - level).mean())
    assert np.mean(errors["empirical"]) < 0.8 * np.mean(errors["natural"])


def test_bank_file_keeps_the_learned_textures(tmp_path):
    stack = render_psf_stack(Mask.named("levin"), SIZES)
    prior = EmpiricalPrior.from_images([texture(weave)], kinds=2)
    bank = learn_bank(stack, LearnConfig(window_px=16), prior)
    save_bank(bank, tmp_path / "bank.npz")
    loaded = load_bank(tmp_path / "bank.npz")
    assert loaded.prior == prior
    image = blurred_texture(stack.psfs[3])
    ours = bank.energies(image, 16, 0.002)
    assert np.array_equal(ours, loaded.energies(image, 16, 0.002))


def test_from_the_command_line(tmp_path, capsys):
    folder = tmp_path / "sharp"
    for seed in range(3):
        write_image(folder / f"{seed}.png", texture(weave, seed))
    bank_file = tmp_path / "bank.npz"
    arguments = ("--mask", "levin", "--blur-sizes", 3, 9, 4, "--window-px", 16, "-o", bank_file)
    result = call(capsys, "learn", *arguments, "--images", folder)
    assert (result.status, result.err) == (0, "")
    assert "4 kinds of texture from sharp images" in result.out
    assert isinstance(load_bank(bank_file).prior, EmpiricalPrior)
    missing = tmp_path / "nothing"
    refused(call(capsys, "learn", *arguments, "--images", missing), missing)
    write_image(missing / "flat.png", np.full((90, 90), 0.4, np.float32))
    refused(
        call(capsys, "learn", *arguments, "--images", missing),
        missing,
        "0 windows with texture are too few for 4 kinds",
    )
    write_image(missing / "flat.png", np.full((60, 90), 0.4, np.float32))
    refused(call(capsys, "learn", *arguments, "--images", missing), missing, "90x60 px is smaller")


def test_impossible_deviations_are_refused():
    with pytest.raises(InputError, match="expected 9 for each of 2 slopes"):
        EmpiricalPrior(slopes=(1.0, 2.0))
    with pytest.raises(InputError, match="finite"):
        EmpiricalPrior(slopes=(1.0,), deviations=((np.nan,) * 9,))
    with pytest.raises(InputError, match="0 windows"):
        EmpiricalPrior.from_images([])
