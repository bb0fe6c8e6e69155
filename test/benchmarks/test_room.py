"""A room in space: what cameras see of it, and how far ways through it are off."""

import dataclasses

import numpy as np
import pytest
from coded_aperture_benchmarks.datasets.room import Board, Room, random_room, walk
from coded_aperture_benchmarks.metrics.trajectories import tracked, write_tum

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, render_psf_stack

pytest.importorskip("numba", reason="a room needs numba")

CAMERA = Camera(600.0, 0.8, 160, 120, Mask.named("zhou"), 20.0)


def wall(depth_m):
    """Return a room that is one textured wall across the view."""
    corner = np.array([-4.0, -3.0, depth_m])
    right, down = np.array([8.0, 0, 0]), np.array([0, 6.0, 0])
    return Room((Board(corner, right, down, 3, 0.2, 0.4, 0.004),))


@pytest.mark.parametrize("depth_m", [0.6, 1.5, 3.0])
def test_a_wall_is_blurred_by_the_psf_of_its_depth(depth_m):
    side = "near" if depth_m < CAMERA.focus_distance_m else "far"
    camera = dataclasses.replace(CAMERA, side=side)
    sharp, true_m = wall(depth_m).seen(camera, np.eye(4))
    np.testing.assert_allclose(true_m, depth_m, rtol=1e-5)
    coded = wall(depth_m).coded(camera, np.eye(4))
    psf = render_psf_stack(camera.mask, [float(camera.blur_size_px(depth_m))]).psfs[0]
    reach = psf.shape[0] // 2
    windows = np.lib.stride_tricks.sliding_window_view(sharp, psf.shape)
    expected = np.einsum("yxij,ij->yx", windows, psf[::-1, ::-1])
    inside = coded[reach:-reach, reach:-reach]
    assert np.std(sharp) > 0.01
    # Interpolated textures are a little smoother than pixels.
    assert np.sqrt(np.mean((inside - expected) ** 2)) < 0.05 * np.std(inside)


@pytest.mark.slow
def test_a_camera_walks_through_a_room_and_stays_out_of_its_furniture():
    room, poses = random_room(1), walk(1, 20.0, 0.5)
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(20, abs=0.6)
    np.testing.assert_allclose(steps_m[9:], 0.5, rtol=0.02)
    assert (np.diff(steps_m[:9]) > 0).all()  # from rest
    turned = poses[:, :3, :3]
    np.testing.assert_allclose(
        turned @ turned.transpose(0, 2, 1), [np.eye(3)] * len(poses), atol=1e-9
    )
    for pose in poses[::4]:
        light, depth_m = room.seen(CAMERA, pose)
        assert depth_m.min() > 0.4  # surrounded by walls, none too near
        assert light.min() > 0.01 and light.max() < 2


def test_what_hides_what_moves_with_the_camera():
    near = Board(
        np.array([-0.1, -0.1, 1.5]),
        np.array([0.2, 0, 0]),
        np.array([0, 0.2, 0]),
        5,
        0.5,
        0.1,
        0.004,
    )
    room = Room((near, *wall(3.0).boards))
    moved = np.eye(4)
    moved[0, 3] = 0.1
    columns = []
    for pose in (np.eye(4), moved):
        _, depth_m = room.seen(CAMERA, pose)
        columns.append(np.flatnonzero((depth_m < 2).any(axis=0)).mean())
    assert columns[0] - columns[1] == pytest.approx(0.1 * 600 / 1.5, abs=1)


def test_ways_are_compared_as_they_are():
    true = walk(2, 6.0, 0.1)
    exact = tracked(true, np.linalg.inv(true[0]) @ true, 1.0)
    assert exact["scale"] == pytest.approx(1, abs=1e-4)
    assert max(exact["drift_per_m"], exact["turn_per_m_deg"], exact["end_per_m"]) < 1e-4
    longer = np.linalg.inv(true[0]) @ true
    longer[:, :3, 3] *= 1.1
    off = tracked(true, longer, 1.0)
    assert off["scale"] == pytest.approx(1.1, abs=1e-3)
    assert off["drift_per_m"] == pytest.approx(0.1, abs=0.005)
    assert off["turn_per_m_deg"] < 1e-3
    with pytest.raises(InputError, match="does not move"):
        tracked(true[:1].repeat(3, axis=0), longer[:3], 1.0)
    short = tracked(true[:20], longer[:20], 1.0)
    assert short["segment_m"] == pytest.approx(short["way_m"] / 2, abs=1e-4)
    assert short["drift_per_m"] == pytest.approx(0.1, abs=0.01)


def test_ways_are_written_as_evo_reads_them(tmp_path):
    poses = walk(3, 5.0, 0.5)
    write_tum(poses, tmp_path / "way.tum")
    table = np.loadtxt(tmp_path / "way.tum")
    assert table.shape == (len(poses), 8)
    np.testing.assert_allclose(table[:, 1:4], poses[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(table[:, 4:], axis=1), 1, atol=1e-5)
