"""Outputs appear whole or not at all."""

import contextlib
import os
import resource
import stat
from pathlib import Path

import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output, output_set
from coded_aperture_ros.io import read_depth, write_depth


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


def test_permissions_of_the_old_file_stay(tmp_path):
    target = tmp_path / "private.yaml"
    target.write_text("old")
    target.chmod(0o600)
    with atomic_output(target) as path:
        path.write_text("new")
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o600


def test_the_umask_is_never_changed(tmp_path, monkeypatch):
    """Files of other threads would get the permissions of that moment."""
    monkeypatch.setattr(os, "umask", lambda _: pytest.fail("it was changed"))
    with atomic_output(tmp_path / "a.txt") as path:
        path.write_text("x")


@contextlib.contextmanager
def largest_file(size):
    """Let longer files fail, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("suffix", [".npy", ".tiff", ".png"])
def test_of_a_set_all_files_appear_or_none(tmp_path, suffix):
    small, large = tmp_path / f"small{suffix}", tmp_path / f"large{suffix}"
    depth_m = np.random.default_rng(0).uniform(1, 5, (200, 300)).astype(np.float32)
    small.write_bytes(b"old")
    with (
        largest_file(50_000),
        pytest.raises(InputError, match=r"cannot write .*large"),
        output_set(),
    ):
        write_depth(small, depth_m[:8, :8])
        write_depth(large, depth_m)
    assert names(tmp_path) == [small.name]
    assert small.read_bytes() == b"old"
    with output_set():
        write_depth(small, depth_m[:8, :8])
        with output_set():
            write_depth(large, depth_m)
        assert not large.exists()
    assert read_depth(small).shape == (8, 8) and read_depth(large).shape == depth_m.shape
    assert sorted(names(tmp_path)) == sorted([small.name, large.name])


def test_an_interrupted_set_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), output_set():
        write_depth(tmp_path / "a.npy", np.ones((4, 4)))
        raise KeyboardInterrupt
    assert names(tmp_path) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_named(tmp_path):
    """NumPy's own message is how many bytes it has written."""
    with (
        pytest.raises(InputError, match=r"cannot write .*x\.npy: No space left on device"),
        atomic_output(tmp_path / "x.npy"),
        Path("/dev/full").open("wb") as full,
    ):
        np.ones(100_000).tofile(full)
    assert names(tmp_path) == []


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
