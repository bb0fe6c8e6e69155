"""YAML files of strangers: bounded, and nothing in them is lost."""

import os

import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.yaml_file import read_yaml
from coded_aperture_ros.optics import load_camera, load_intrinsics

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a, *a]\n"
CAMERA = """\
focal_length_px: 400.0
focus_distance_m: 1.0
image_width: 176
image_height: 128
mask: {name: levin}
mask_extent_mm: 40.0
"""


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("a: 1\nb: 2\na: 3\n", "a is in line 1 and in line 3: delete one of them"),
        ("a:\n  b: 1\n  b: 1\n", "b is in line 2 and in line 3"),
        ("- {c: 1,\n   c: 2}\n", "c is in line 1 and in line 2"),
        ("1: x\n1: y\n", "1 is in line 1 and in line 2"),
        ("\"a\": 1\n'a': 2\n", "a is in line 1 and in line 2"),
        ("a: 1\n<<: {a: 2}\nb: {\n", "not valid YAML"),
        (BOMB, "line 2 has an alias"),
        ("a: &x {b: *x}\n", "line 1 has an alias"),
        ("[" * 3000, "not valid YAML"),
        ("{a: " * 3000, "not valid YAML"),
        ("a: 2026-99-99\n", "not valid YAML"),
        ("!!python/object:os.system x\n", "not valid YAML"),
        ("a: 1\n" + "# \n" * 400_000, "bytes, expected at most 1048576"),
    ],
)
def test_what_is_refused(tmp_path, text, phrase):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_yaml(path, "a.yaml")
    line = str(caught.value)
    assert line.removeprefix("cannot read ").startswith("a.yaml: ") and phrase in line
    assert "\n" not in line and len(line) < 200


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/tty", ".", "/proc/self/mem"])
def test_only_regular_files_are_read(path):
    with pytest.raises(InputError, match=f"^(cannot read )?{path}: "):
        read_yaml(path, path)


def test_a_pipe_does_not_hold_up_the_program(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        read_yaml(tmp_path / "pipe", "pipe")


@pytest.mark.parametrize("load", [load_camera, load_intrinsics])
def test_cameras_and_calibrations_are_read_by_it(tmp_path, load):
    path = tmp_path / "camera.yaml"
    path.write_text(f"mask_extent_mm: 22.0\n{CAMERA}")
    with pytest.raises(InputError, match="mask_extent_mm is in line 1 and in line 7"):
        load(path)


@pytest.mark.parametrize("value", [list(range(10_000)), "x" * 100_000, {"a": [[1] * 99] * 99}])
def test_a_message_does_not_repeat_what_is_long(tmp_path, value):
    path = tmp_path / "camera.yaml"
    path.write_text(CAMERA.replace("400.0", str(value)))
    with pytest.raises(InputError) as caught:
        load_camera(path)
    assert "focal_length_px" in str(caught.value) and len(str(caught.value)) < 300
