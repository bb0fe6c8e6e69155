"""The examples that the commands' `--help` shows, typed as they stand."""

import re
import shutil
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from asymmetric_planes import few_steps, folder_of
from cli_scene import call, examples, parsed, texture
from psf_pictures import measured_file

from coded_aperture_ros.io import read_depth

DEPTH_M = 1.2


@pytest.mark.slow
def test_every_example_works_in_a_checkout(tmp_path, capsys, monkeypatch, checkout):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(checkout / "config", tmp_path / "config")
    for file in (tmp_path / "config").glob("*.yaml"):  # smaller frames, which take less time
        text = re.sub(r"^image_width: .*", "image_width: 250", file.read_text(), flags=re.M)
        file.write_text(re.sub(r"^image_height: .*", "image_height: 200", text, flags=re.M))
    sharp = texture(200, 250)
    cv2.imwrite("sharp.png", np.rint(255 * sharp ** (1 / 2.2)).astype(np.uint8))
    cv2.imwrite("depth.png", np.full(sharp.shape, 1000 * DEPTH_M, np.uint16))
    measured_file("stack.npz")
    (tmp_path / "planes").mkdir()
    folder_of(tmp_path / "planes")
    few_steps(monkeypatch)
    (tmp_path / "pictures").mkdir()
    for seed in range(5):
        picture = texture(256, 256, seed) ** (1 / 2.2)
        cv2.imwrite(f"pictures/{seed}.png", np.rint(255 * picture).astype(np.uint8))

    def type_in(arguments):
        result = call(capsys, *arguments)
        assert (result.status, result.err) == (0, ""), arguments
        return result.out

    design = examples(capsys, "design")
    assert len(design) == 5
    for arguments in design[:2]:  # a minute each
        assert parsed(*arguments).wanted
    for arguments in design[2:]:
        assert "depth levels told apart" in type_in(arguments)
    assert (tmp_path / "design" / "design.html").is_file()

    print_mask = examples(capsys, "mask") + examples(capsys, "mask print")
    assert len(print_mask) == 8
    for arguments in print_mask:
        type_in(arguments)
    assert (tmp_path / "mask.pdf").is_file()
    assert (tmp_path / "mask.svg").is_file()

    score_masks = examples(capsys, "mask score")
    assert len(score_masks) == 2
    for arguments in score_masks:
        assert "levin" in type_in(arguments)
    # The others take minutes, and a cluster.
    (short,) = (line for line in examples(capsys, "mask search") if "cardboard.png" in line)
    type_in(short)
    assert (tmp_path / "cardboard.png").is_file()

    simulate, simulate_random = examples(capsys, "simulate")
    type_in(simulate)
    if find_spec("numba"):
        type_in(simulate_random)
    (tmp_path / "frames").mkdir()
    shutil.copy("coded.png", "frames/first.png")

    learn = examples(capsys, "learn")
    assert len(learn) == 7
    (trained,) = (line for line in learn if "--train" in line)  # half an hour, and PyTorch
    assert parsed(*trained).train == 30
    learn.remove(trained)
    for arguments in reversed(learn):  # the first one's bank fits the simulated camera
        type_in(arguments)

    # Without loss: in one with it there is no depth.
    video = cv2.VideoWriter("video.avi", cv2.VideoWriter_fourcc(*"FFV1"), 10, (250, 200))
    for _ in range(3):
        video.write(cv2.imread("coded.png"))
    video.release()
    camera = Path("config/demo_camera.yaml").read_text()
    Path("camera.yaml").write_text(camera)
    Path("config/refocused_camera.yaml").write_text(
        re.sub(r"^focus_distance_m: .*", "focus_distance_m: 0.6", camera, flags=re.M)
    )
    second = [word.replace("demo_camera", "refocused_camera") for word in simulate]
    type_in([word.replace("coded.png", "refocused.png") for word in second])
    Path("way.txt").write_text("".join(f"{i} 0 0 0 0 0 0 1\n" for i in range(9)))
    depth = examples(capsys, "depth")
    assert len(depth) == 8
    for arguments in depth:
        type_in(arguments)
    assert np.nanmedian(read_depth("depth.npy")) == pytest.approx(DEPTH_M, rel=0.05)
    assert (tmp_path / "depth" / "first.npy").is_file()
    assert (tmp_path / "depth" / "video_000002.npy").is_file()
    assert (tmp_path / "two_pixel.npy").is_file()
    assert (tmp_path / "depth.comparison.png").is_file()
    assert (tmp_path / "moving.motion.npy").is_file()

    deblur = examples(capsys, "deblur")
    assert len(deblur) == 4
    for arguments in deblur:
        (tmp_path / "sharp.png").unlink()
        type_in(arguments)
        assert (tmp_path / "sharp.png").is_file()
    assert len(list((tmp_path / "views").iterdir())) > 1
