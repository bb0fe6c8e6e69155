"""Frames of which most lies at an open end of the levels do not fit."""

import cv2
import numpy as np
import pytest

from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.quality import Health
from coded_aperture_ros.depth.stages.quality_of_fit import limit_at_end, open_ends
from coded_aperture_ros.likelihood.bank import learn_bank
from coded_aperture_ros.optics import Mask, render_psf, render_psf_stack
from coded_aperture_ros.pipeline import FramePipeline


@pytest.fixture(scope="module")
def bank():
    return learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(3, 10, 15)))


def health_of(levels, at, share, sure=0.9, before=0.95):
    level = np.full((60, 80), 7.0, np.float32)
    level[: round(60 * share)] = at
    confidence = np.full((60, 80), sure, np.float32)
    return limit_at_end(Health(before), levels, level, confidence)


@pytest.mark.parametrize(("at", "share", "fits"), [(0.3, 0.9, False), (13.5, 0.9, False),
                                                   (0.3, 0.4, True), (4.0, 0.9, True)])  # fmt: skip
def test_most_at_an_end_does_not_fit(bank, at, share, fits):
    assert health_of(Levels.from_model(bank), at, share).fits == fits


def test_what_is_unsure_says_nothing(bank):
    assert health_of(Levels.from_model(bank), 0.3, 0.9, sure=0.3).fits


def test_a_worse_health_and_its_cause_stay(bank):
    levels = Levels.from_model(bank)
    level, sure = np.zeros((60, 80), np.float32), np.ones((60, 80), np.float32)
    assert limit_at_end(Health(0.1, "none"), levels, level, sure) == Health(0.1, "none")
    assert limit_at_end(None, levels, level, sure) == Health(0.4, "range")


def test_nothing_is_beyond_sharp_or_infinity(bank):
    sharp = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(0.2, 10, 20)))
    assert open_ends(Levels.from_model(sharp)) == (False, True)
    assert open_ends(Levels.from_model(bank)) == (True, True)


def test_a_wall_at_the_end_of_the_levels_is_withheld(bank):
    picture = np.random.default_rng(0).random((192, 256), np.float32)
    for size_px, fits in ((3.0, False), (6.0, True)):
        psf = render_psf(Mask.named("levin"), size_px)
        coded = cv2.filter2D(picture, -1, psf, borderType=cv2.BORDER_REFLECT)
        noise = 0.002 * np.random.default_rng(1).standard_normal(coded.shape, dtype=np.float32)
        pipeline = FramePipeline(bank, deblur=None)
        found = pipeline(coded + noise)
        pipeline.close()
        assert found.health.fits == fits
        assert found.health.cause == ("" if fits else "range")
        assert (np.isnan(found.level).mean() < 0.2) == fits
