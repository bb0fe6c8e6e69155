"""`python -m coded_aperture_benchmarks views`: true views, other focuses, and one tiny scene."""

import cv2
import numpy as np
import pytest
from cli_scene import call_benchmarks, json_of_benchmarks
from coded_aperture_benchmarks.suites import views

from coded_aperture_ros.metrics import psnr_db
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.simulation.layered import random_scene
from coded_aperture_ros.simulation.layered.tracing import lens_samples

pytest.importorskip("numba", reason="random scenes need numba")
SHAPE = (80, 96)


@pytest.fixture(scope="module")
def scene():
    """Return a small random scene."""
    return random_scene(1, Mask.named("levin"), "far", SHAPE)


def test_the_coded_frame_is_the_mean_of_the_true_views(scene):
    """So the views are on the side of the aperture where the mask's openings are."""
    mask = Mask.named("zhou")  # has no symmetry
    samples = lens_samples(mask, float(scene.blur_size_px().max()))
    mean = sum(share * views.true_view(scene, down, right) for down, right, share in samples)
    np.testing.assert_allclose(mean, scene.coded(mask), atol=1e-4)


def test_what_a_round_lens_is_focused_on_is_sharp(scene):
    """Its own blur size leaves it as it is in the all-in-focus frame."""
    blur, sharp = scene.blur_size_px(), scene.all_in_focus()
    for share in (10, 90):
        focus_px = float(np.percentile(blur, share))
        error = np.abs(views.through_disc(scene, focus_px) - sharp)
        near, away = (np.abs(blur - focus_px) < 0.3), (np.abs(blur - focus_px) > 3)
        near = cv2.erode(near.astype(np.uint8), np.ones((13, 13))) > 0
        assert near.sum() > 50
        assert error[near].mean() < 0.3 * error[away].mean()
        ours = views.synthetic_aperture(views._views_of(np.clip(sharp, 0, 1), blur), focus_px)
        assert psnr_db(ours, views.through_disc(scene, focus_px)) > psnr_db(sharp, ours) + 6


def test_opposite_openings():
    places = [(0.0, 0.1), (-0.4, 0.3), (0.1, 0.1), (0.35, -0.3)]
    assert views._opposite(places) == ((-0.4, 0.3), (0.35, -0.3))


@pytest.mark.slow
def test_one_tiny_scene(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    arguments = ("views", "--scenes", 1, "--first-scene", 1, "--size", "96x80")
    results = json_of_benchmarks(capsys, *arguments, "--jobs", 1, "--output", tmp_path)
    rows = {row["given"]: row for row in results["rows"]}
    assert list(rows) == [
        "true",
        "found depth",
        "sparse, true depth",
        "sparse",
        "fast",
        "not moved",
    ]
    assert {row["openings"] for row in rows.values()} == {42}  # beside the one in the middle
    for row in rows.values():
        assert row["worst_db"] <= row["mean_db"]
    assert rows["true"]["mean_db"] > rows["found depth"]["mean_db"] > rows["sparse"]["mean_db"]
    assert rows["sparse"]["mean_db"] > rows["not moved"]["mean_db"] + 3
    assert rows["sparse"]["middle_db"] == rows["not moved"]["middle_db"]
    focuses = [row for row in results["focus_rows"] if row["given"] == "sparse"]
    assert [row["share"] for row in focuses] == [5, 50, 95]
    pooled = {row["given"]: row for row in results["focus_pooled"]}
    assert pooled["true"]["mean_db"] > pooled["sparse"]["mean_db"] > pooled["not moved"]["mean_db"]
    assert cv2.imread(str(tmp_path / "views_1.jpg")).shape[1] > 3 * 96
    text = views._text(results)
    assert "42 openings of levin" in text
    assert f"{rows['sparse']['mean_db']:.1f} / {rows['sparse']['worst_db']:.1f}" in text


def test_the_worst_scene_comes_first():
    rows = [
        {"scene": scene, "given": name, "openings": 9, "mean_db": db, "worst_db": db - 1}
        for scene, db in ((0, 31.0), (1, 22.0), (2, 40.0))
        for name in views._OF_VIEWS
    ]
    focuses = [
        {"scene": scene, "given": name, "share": 50, "db": 30.0}
        for scene in range(3)
        for name in views._OF_FOCUS
    ]
    results = {"rows": rows, "focus_rows": focuses, "pooled": [], "focus_pooled": [], "scenes": 3}
    results |= {"mask": "levin", "side_of_focus": "far", "noise": 0.0, "goal_db": 30.0}
    lines = views._text(results).splitlines()
    assert [line.split()[0] for line in lines[3:6]] == ["1", "0", "2"]


@pytest.mark.parametrize(("option", "value"), [("--mask", "levins"), ("--side", "left")])
def test_wrong_options_are_refused(capsys, option, value):
    refused = call_benchmarks(capsys, "views", option, value)
    assert (refused.status, refused.out) == (2, "")
    assert option in refused.err and value in refused.err
