"""The command `learn`, and what every command does with files that it cannot use."""

import json
import os
import sys

import numpy as np
import pytest
from cli_scene import CAMERA, call, camera_file, everything, forbid_work, refused, wrong_usage
from psf_pictures import measured_file
from waiting import run_python

from coded_aperture_ros.calibration.psf import nominal
from coded_aperture_ros.likelihood.bank import load_bank
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack

SMALL = ("--window-px", 16, "--rank", 8)


def test_from_a_camera(scene, tmp_path, capsys):
    bank_file = tmp_path / "new folder" / "bank.npz"
    result = call(
        capsys,
        *("learn", "--camera", scene.camera, "--depth-range", 1.5, 3, "--level-count", 5),
        *(*SMALL, "-o", bank_file, "--parents"),
    )
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith(f"{bank_file}: 5 levels, ")
    bank = load_bank(bank_file)
    camera = Camera(**{**CAMERA, "mask": Mask.named("levin")})
    assert bank.blur_sizes_px == pytest.approx(np.linspace(*camera.blur_size_px([1.5, 3]), 5))
    assert bank.stack.depths_m[[0, -1]] == pytest.approx([1.5, 3])
    assert (bank.window_px, bank.basis.shape[1], bank.noise) == (16, 8, 0)
    assert sorted(everything(tmp_path)) == sorted(
        path.relative_to(tmp_path) for path in (bank_file.parent, bank_file)
    )


def test_from_a_mask_file_with_known_noise(tmp_path, capsys):
    mask = tmp_path / "mask.npy"
    np.save(mask, Mask.named("zhou").transmission)
    result = call(
        capsys,
        *("learn", "--mask", mask, "--blur-sizes", 3, 9, 4, "--noise", 0.003, *SMALL),
        *("-o", tmp_path / "bank.npz", "--json"),
    )
    assert (result.status, result.err) == (0, "")
    summary = json.loads(result.out)
    assert summary["output"] == str(tmp_path / "bank.npz")
    assert (summary["levels"], summary["blur_size_min_px"], summary["blur_size_max_px"]) == (
        4,
        3,
        9,
    )
    assert (summary["window_px"], summary["rank"]) == (16, 8)
    assert str(mask) in summary["learned_from"]
    bank = load_bank(tmp_path / "bank.npz")
    named = render_psf_stack(Mask.named("zhou"), np.linspace(3, 9, 4))
    assert np.array_equal(bank.stack.psfs, named.psfs)
    assert bank.noise == 0.003


@pytest.mark.parametrize(
    ("in_file", "options", "sizes", "depths"),
    [
        ({}, (), [0, 1, 2], None),
        ({"sizes": [4, 6.5, 9]}, (), [4, 6.5, 9], None),
        ({"depths": [1, 2, 3]}, (), [0, 1, 2], [1, 2, 3]),
        ({"depths": [1, 2, 3]}, ("--depths", "1.5,2.5,4"), [0, 1, 2], [1.5, 2.5, 4]),
        ({}, ("--depths", "3,2,1"), [0, 1, 2], [3, 2, 1]),
    ],
)
def test_from_measured_psfs(tmp_path, capsys, in_file, options, sizes, depths):
    psfs = measured_file(tmp_path / "psfs.npz", **in_file)
    bank_file = tmp_path / "bank.npz"
    result = call(capsys, "learn", "--psfs", psfs, *options, *SMALL, "-o", bank_file)
    assert (result.status, result.err) == (0, "")
    bank = load_bank(bank_file)
    assert bank.blur_sizes_px.tolist() == sizes
    assert bank.stack.psfs.sum(axis=(1, 2)) == pytest.approx(1)
    if depths is None:
        assert bank.stack.depths_m is None
    else:
        assert bank.stack.depths_m.tolist() == depths


def test_psfs_without_sizes_get_nominal_ones(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(nominal, "fitting_share", lambda *_: 1.0)  # a check of its own takes long
    sizes_px = np.linspace(4, 9, 8)
    psfs = tmp_path / "psfs.npz"
    np.savez(psfs, psfs=render_psf_stack(Mask.named("levin"), sizes_px).psfs)
    result = call(capsys, "learn", "--psfs", psfs, "-o", tmp_path / "bank.npz")
    assert result.status == 0
    assert " px (nominal), from measured PSFs" in result.out
    bank = load_bank(tmp_path / "bank.npz")
    assert bank.stack.nominal
    assert bank.blur_sizes_px == pytest.approx(sizes_px, rel=0.2)


CAMERA_RANGE = ("--camera", "camera.yaml", "--depth-range", 1.5, 3)
REMAP = ("--remap", "bank.npz", "--camera", "camera.yaml")


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ((), "required"),
        (("--camera", "c.yaml"), "--camera: needs --depth-range or --remap too"),
        (("--blur-sizes", 3, 9, 4), "--blur-sizes: needs --mask too"),
        (("--blur-sizes", 9, 3, 4, "--mask", "levin"), "MIN less than MAX"),
        (("--blur-sizes", 3, 9, 1, "--mask", "levin"), "at least 2 levels"),
        (("--blur-sizes", 3, "inf", 4, "--mask", "levin"), "MIN less than MAX"),
        (("--blur-sizes", 3, 9, 4.5, "--mask", "levin"), "a whole number of levels"),
        ((*CAMERA_RANGE, "--level-count", 1), "--level-count: 1 is out of range (at least 2)"),
        ((*CAMERA_RANGE, "--mask", "levin"), "--mask: only with --blur-sizes"),
        ((*CAMERA_RANGE, "--depths", "1,2"), "--depths: only with --psfs"),
        (("--psfs", "a.npz", "--level-count", 5), "--level-count: only with --camera or --planes"),
        ((*CAMERA_RANGE, "--psfs", "a.npz"), "--camera: not with --psfs"),
        (("--planes", "folder", "--psfs", "a.npz"), "--psfs: not with --planes"),
        (("--planes", "folder", "--depths", "1,2"), "--depths: only with --psfs"),
        (("--planes", "folder", "--images", "other"), "--images: not with --planes"),
        ((*CAMERA_RANGE, "--gamma", "srgb"), "--gamma: only with --images or --planes"),
        ((*REMAP, "--window-px", 64), "--window-px: not with --remap"),
        ((*REMAP, "--noise", 0.01), "--noise: not with --remap"),
        ((*CAMERA_RANGE, "--window-px", 8), "--window-px: expected 0 or an even number from 16"),
        ((*CAMERA_RANGE, "--window-px", 33), "--window-px: expected 0 or an even number"),
        ((*CAMERA_RANGE, "--rank", 0), "--rank: 0 is out of range"),
        ((*CAMERA_RANGE, "--noise", -1), "--noise: -1.0 is out of range"),
        ((*CAMERA_RANGE, "--noise", "loud"), "invalid float value: 'loud'"),
    ],
)
def test_wrong_usage(tmp_path, capsys, monkeypatch, arguments, phrase):
    monkeypatch.chdir(tmp_path)
    camera_file(tmp_path)
    before = everything(tmp_path)
    wrong_usage(call(capsys, "learn", *arguments, "-o", "bank.npz"), "learn", phrase)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("changes", "phrases"),
    [
        ({"focal_lenght_px": 3}, ["unknown key 'focal_lenght_px'", "did you mean focal_length_px"]),
        ({"focal_length_px": -400.0}, ["focal_length_px", "-400.0 is out of range"]),
        ({"focal_length_px": "long"}, ["focal_length_px", "expected float"]),
        ({"focus_distance_m": 2.0}, ["focus at 2 m lies inside the depth range 1.5 to 3 m"]),
        ({"focus_distance_m": 5.0}, ["set side: near"]),
        ({"mask": {"name": "levine"}}, ["unknown mask 'levine'", "did you mean levin?"]),
        ({"mask": {"file": "no.png"}}, ["cannot read mask", "no.png"]),
        ({"mask": None}, ["missing mask"]),
        ({"mask_extent_mm": 1600.0}, ["does not fit the 256 px window", "larger window"]),
    ],
)
def test_unusable_camera_files(tmp_path, capsys, changes, phrases):
    camera = camera_file(tmp_path, **changes)
    before = everything(tmp_path)
    result = call(
        capsys,
        *("learn", "--camera", camera, "--depth-range", 1.5, 3, "--level-count", 3),
        *("-o", tmp_path / "bank.npz"),
    )
    refused(result, camera, *phrases)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("depth_range", "phrase"),
    [
        ((3, 1.5), "two increasing distances"),
        ((-1, 2), "two increasing distances"),
        (("nan", 2), "two increasing distances"),
        ((1.5, "inf"), "depth"),
    ],
)
def test_impossible_depth_ranges(scene, tmp_path, capsys, depth_range, phrase):
    result = call(
        capsys,
        *("learn", "--camera", scene.camera, "--depth-range", *depth_range, "--level-count", 3),
        *("-o", tmp_path / "bank.npz"),
    )
    refused(result, scene.camera, phrase)
    assert everything(tmp_path) == {}


@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (b"", "expected keys and values"),
        (b"focal_length_px: [1", "not valid YAML in line"),
        (b"\xff\xfe\x00", "not valid YAML"),
        (b"- 1\n- 2\n", "expected keys and values"),
    ],
)
def test_files_that_are_no_camera_file(tmp_path, capsys, content, phrase):
    camera = tmp_path / "camera.yaml"
    camera.write_bytes(content)
    arguments = ("--camera", camera, "--depth-range", 1, 2, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), camera, phrase)
    assert list(everything(tmp_path).values()) == [content]


@pytest.mark.parametrize("name", ["missing.yaml", "."])
def test_a_camera_file_that_cannot_be_read(tmp_path, capsys, name):
    camera = tmp_path / name
    arguments = ("--camera", camera, "--depth-range", 1, 2, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), "cannot read camera file", camera)


@pytest.mark.parametrize(
    ("arrays", "options", "phrases"),
    [
        ({"kernels": np.ones((3, 5, 5))}, (), ["it has no array named psfs"]),
        ({"psfs": np.ones((5, 5))}, (), ["expected the shape [N, k, k], got [5, 5]"]),
        ({"psfs": np.ones((3, 4, 4))}, (), ["odd width", "got 4"]),
        ({"psfs": np.full((3, 5, 5), np.nan)}, (), ["finite"]),
        ({"psfs": np.zeros((3, 5, 5))}, (), ["PSF 0 has the sum 0: it has to be positive"]),
        ({"psfs": np.ones((3, 5, 5)) - [[[0]], [[0]], [[1.008]]]}, (), ["PSF 2 has the sum -0.2:"]),
        ({"psfs": np.ones((3, 5, 5)), "sizes_px": np.ones(2)}, (), ["sizes_px: expected 3"]),
        ({"psfs": np.ones((3, 5, 5)), "depths_m": [0, 1, 2]}, (), ["more than 0 m"]),
        ({"psfs": np.ones((1, 5, 5))}, (), ["at least 2 levels, got 1"]),
        ({"psfs": np.ones((501, 5, 5))}, (), ["at most 500 levels, got 501"]),
        ({"psfs": np.ones((3, 17, 17))}, (), ["17 px does not fit the 16 px window"]),
        ({"psfs": np.array([{}, None])}, (), ["not an .npz of plain arrays"]),
        ({"psfs": np.array(["a", "b"])}, (), ["could not convert"]),
    ],
)
def test_unusable_measured_psfs(tmp_path, capsys, arrays, options, phrases):
    psfs = tmp_path / "psfs.npz"
    np.savez(psfs, **arrays)
    before = everything(tmp_path)
    arguments = ("--psfs", psfs, *options, *SMALL, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), psfs, *phrases)
    assert everything(tmp_path) == before


@pytest.mark.parametrize(
    ("depths", "phrase"),
    [("1,2", "expected 3 finite numbers"), ("1,0,2", "more than 0 m"), ("1,inf,2", "finite")],
)
def test_depths_that_do_not_fit_the_psfs(tmp_path, capsys, depths, phrase):
    psfs = measured_file(tmp_path / "psfs.npz")
    arguments = ("--psfs", psfs, "--depths", depths, *SMALL, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), "--depths", phrase)
    wrong = call(capsys, "learn", "--psfs", psfs, "--depths", "1;2;3", "-o", tmp_path / "b.npz")
    wrong_usage(wrong, "learn", "expected numbers with commas between, got '1;2;3'")


@pytest.mark.parametrize("mask", ["levine", "picture.txt", "three_d.npy", "dark.npy", "bright.npy"])
def test_unusable_masks(tmp_path, capsys, mask):
    (tmp_path / "picture.txt").write_text("no picture")
    np.save(tmp_path / "three_d.npy", np.ones((3, 3, 3)))
    np.save(tmp_path / "dark.npy", np.zeros((3, 3)))
    np.save(tmp_path / "bright.npy", np.full((3, 3), 255.0))
    before = everything(tmp_path)
    given = tmp_path / mask if (tmp_path / mask).exists() else mask
    arguments = ("--mask", given, "--blur-sizes", 3, 9, 3, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "learn", *arguments), mask)
    assert everything(tmp_path) == before


def test_a_bank_that_exists_survives_a_failure(scene, tmp_path, capsys):
    bank_file = tmp_path / "bank.npz"
    bank_file.write_bytes(b"old")
    arguments = ("--camera", scene.camera, "--depth-range", 0.5, 3, "-o", bank_file)
    refused(call(capsys, "learn", *arguments), "lies inside the depth range")
    assert list(everything(tmp_path).values()) == [b"old"]


@pytest.mark.parametrize(
    ("output", "phrase"),
    [
        ("bank.png", "unknown format, use a name that ends in .npz"),
        ("bank", "unknown format, use a name that ends in .npz"),
        ("folder.npz", "it is a folder"),
        ("file/bank.npz", "is not a folder"),
        ("file/new/bank.npz", "is not a folder"),
        ("/proc/bank.npz", "cannot write /proc/bank.npz"),
    ],
)
def test_impossible_outputs_are_refused_before_learning(
    scene, tmp_path, capsys, monkeypatch, output, phrase
):
    forbid_work(monkeypatch, "cli.learn.learn_bank_for_camera")
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.npz").mkdir()
    before = everything(tmp_path)
    arguments = ("--camera", scene.camera, "--depth-range", 1.5, 3, "-o", tmp_path / output)
    refused(call(capsys, "learn", *arguments), output, phrase)
    assert everything(tmp_path) == before


def test_measured_psfs_are_not_overwritten(tmp_path, capsys):
    psfs = measured_file(tmp_path / "psfs.npz")
    before = everything(tmp_path)
    refused(call(capsys, "learn", "--psfs", psfs, "-o", psfs), psfs, "use another name")
    assert everything(tmp_path) == before


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path):
    program = (
        "import resource, sys\n"
        "from coded_aperture_ros.cli.main import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "sys.exit(main())\n"
    )
    arguments = ("learn", "--mask", "levin", "--blur-sizes", 3, 9, 4, *SMALL, "-o", "bank.npz")
    result = run_python(
        "-c",
        program,
        *map(str, arguments),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert result.stderr.splitlines()[-1:] == [
        "coded_aperture: error: cannot write bank.npz: File too large"
    ]
    assert "Traceback" not in result.stderr
    assert (result.returncode, result.stdout) == (1, "")
    assert everything(tmp_path) == {}


@pytest.mark.parametrize(
    ("largest", "window_px", "stride_px"), [(12, 48, 8), (22, 48, 8), (30, 96, 16)]
)
def test_window_and_stride_follow_the_largest_blur(tmp_path, capsys, largest, window_px, stride_px):
    output = tmp_path / "bank.npz"
    sizes = ("--blur-sizes", 5, largest, 4, "--mask", "levin")
    result = call(capsys, "learn", *sizes, "-o", output)
    assert f"patches of {window_px} px every {stride_px} px" in result.out
    bank = load_bank(output)
    assert (bank.window_px, bank.stride_px) == (window_px, stride_px)
    told = call(capsys, "learn", *sizes, "--window-px", 64, "-o", tmp_path / "told.npz")
    assert "patches of 64 px every 8 px" in told.out
