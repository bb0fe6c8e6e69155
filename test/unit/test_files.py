"""Outputs appear whole or not at all."""

import os
import stat

import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output


def names(folder):
    return [path.name for path in folder.iterdir()]


def test_the_file_appears_at_the_end(tmp_path):
    target = tmp_path / "new" / "folder" / "depth.npy"
    with atomic_output(target) as path:
        assert path.suffix == ".npy"
        assert path.parent == target.parent
        path.write_bytes(b"whole")
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    assert names(target.parent) == ["depth.npy"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "depth.npy"
    target.write_bytes(b"old")
    with pytest.raises(RuntimeError, match="half way"), atomic_output(target) as path:
        path.write_bytes(b"hal")
        raise RuntimeError("half way")
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["depth.npy"]


def test_an_interrupt_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), atomic_output(tmp_path / "a.png"):
        raise KeyboardInterrupt
    assert names(tmp_path) == []


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_permissions_follow_the_umask(tmp_path, umask, mode):
    old = os.umask(umask)
    try:
        with atomic_output(tmp_path / "a.txt") as path:
            path.write_text("x")
    finally:
        assert os.umask(old) == umask
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == mode


def test_a_target_that_is_a_folder_is_one_clear_line(tmp_path):
    (tmp_path / "out.png").mkdir()
    with (
        pytest.raises(InputError, match=r"cannot write .*out\.png") as caught,
        atomic_output(tmp_path / "out.png") as path,
    ):
        path.write_text("x")
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == ["out.png"]


def test_a_parent_that_is_a_file_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot write"), atomic_output(tmp_path / "file" / "a"):
        pytest.fail("the block must not run")
