"""The benchmark of predicted errors of masks, and what it draws."""

import json
import re

import numpy as np
import pytest
from cli_scene import call_benchmarks, picture_folder
from coded_aperture_benchmarks.datasets.random_masks import patches_of_columns

from coded_aperture_ros.design.scores.crops import Textures


def test_patches_of_columns_have_seams():
    bright, dark = np.full((70, 90), 0.8, np.float32), np.full((70, 90), 0.2, np.float32)
    patches = patches_of_columns(Textures("natural", (bright, dark)), 100, 80, 48)
    assert patches.shape == (100, 80, 80)
    assert (patches == patches[:, :, :1]).all()
    seams = [np.flatnonzero(np.diff(patch[:, 0])) for patch in patches]
    assert all(set(np.diff(rows)) <= {48} for rows in seams)
    # They begin anywhere.
    assert len({rows[0] % 48 for rows in seams if len(rows)}) > 25


def test_benchmark_command(capsys):
    small = ["--levels", "5", "--side", "48", "--window", "48", "--rank", "32", "--repeats", "1"]
    result = call_benchmarks(capsys, "masks", "--count", "3", *small, "--jobs", "1", "--json")
    results = json.loads(result.out)
    assert len(results["masks"]) == 3
    assert set(results["rank_correlation"]) == {"0.001", "0.005"}
    assert set(results["rank_correlation_pictures"]) == {"0.001", "0.005"}
    assert all(0 < value < 5 for row in results["masks"] for value in row["predicted_pictures"])
    assert results["masks_per_second"] > 0


@pytest.mark.slow
def test_benchmark_command_with_pictures_of_a_folder(tmp_path, capsys):
    folder = picture_folder(tmp_path)
    small = ["--levels", "5", "--side", "48", "--window", "48", "--rank", "32", "--repeats", "1"]
    small += ["--count", "3", "--windows", "40", "--sigmas", "0.005", "--jobs", "1"]
    of_folder = call_benchmarks(capsys, "masks", *small, "--images", folder, "--json")
    built_in = call_benchmarks(capsys, "masks", *small)
    results = json.loads(of_folder.out)
    assert (results["images"], results["windows"]) == (str(folder), 40)
    first = results["masks"][0]
    shown = built_in.out.splitlines()
    assert "from other crops of the pictures: " in built_in.out
    titles = re.split(r" {2,}", shown[0])
    assert titles[3:] == ["predicted 0.005", "pictures 0.005", "measured 0.005"]
    # Other pictures, other errors; what the mask alone tells stays.
    alone, with_pictures, measured = (float(value) for value in shown[1].split()[3:])
    assert alone == pytest.approx(first["predicted"][0], abs=0.006)
    assert with_pictures != pytest.approx(first["predicted_pictures"][0], abs=0.006)
    assert measured != pytest.approx(first["measured"][0], abs=0.006)
