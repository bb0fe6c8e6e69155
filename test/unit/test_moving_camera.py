"""What a moving camera's past frames tell: motion, parallax, belief; poses that are wrong."""

import types
from itertools import pairwise

import cv2
import numpy as np
import pytest

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig, DepthEstimator, FocusPair
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving import Belief, MovingMemory, Pinhole, Step, Trajectory
from coded_aperture_ros.depth.moving.carrying import carried
from coded_aperture_ros.depth.moving.clearance import clearance_m
from coded_aperture_ros.depth.moving.egomotion import Found, Landmarks
from coded_aperture_ros.depth.moving.fusion import fused
from coded_aperture_ros.depth.moving.parallax import Comparison, Seen, with_parallax
from coded_aperture_ros.depth.moving.uncertainty import motion_covariance
from coded_aperture_ros.depth.stages.free_space import FreeSpace
from coded_aperture_ros.frames import Frame, View
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.likelihood.bank import learn_bank_for_camera
from coded_aperture_ros.optics import Camera, Mask
from coded_aperture_ros.pipeline import FramePipeline

VIEW = Pinhole((120, 160), (150.0, 150.0), (79.5, 59.5))
WALL_M, BOX_M = 3.0, 1.5


def texture(seed, count=60):
    """Smooth light over a plane: a sum of waves, exact at any point."""
    random = np.random.default_rng(seed)
    waves = random.normal(size=(count, 2)) * 18
    phases, heights = random.uniform(0, 2 * np.pi, count), random.normal(size=count)

    def light(x, y):
        total = np.zeros(x.shape)
        for (u, v), phase, height in zip(waves, phases, heights, strict=True):
            total += height * np.cos(u * x + v * y + phase)
        return np.clip(0.4 + 0.1 * total / np.sqrt(count / 2), 0.02, 1)

    return light


WALL, BOX = texture(1), texture(2)


def seen(pose, box=True, box_at=(0.0, 0.0)):
    """Light and depth of a wall, and a box before it, from a pose."""
    rows, columns = np.indices(VIEW.shape)
    rays = np.stack(
        [(columns - VIEW.centre[0]) / 150, (rows - VIEW.centre[1]) / 150, np.ones(VIEW.shape)], -1
    )
    rays, place = rays @ pose[:3, :3].T, pose[:3, 3]
    light, depth = np.zeros(VIEW.shape), np.full(VIEW.shape, np.inf)
    planes = [(WALL_M, WALL, None)] + ([(BOX_M, BOX, 0.3)] if box else [])
    for at_m, paint, half in planes:
        way = (at_m - place[2]) / rays[..., 2]
        x, y = (place[axis] + way * rays[..., axis] for axis in (0, 1))
        hit = way < depth
        if half is not None:
            x, y = x - box_at[0], y - box_at[1]
            hit &= (np.abs(x) < half) & (np.abs(y) < half)
        light = np.where(hit, paint(x, y), light)
        depth = np.where(hit, way, depth)
    return light.astype(np.float32), depth.astype(np.float32)


def moved(x=0.0, y=0.0, z=0.0, yaw=0.0):
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, 0, sine, x], [0, 1, 0, y], [-sine, 0, cosine, z], [0, 0, 0, 1.0]])


WAY = [moved(0.03 * i, 0.01 * i, 0.02 * i, 0.01 * i) for i in range(8)]


def blurred_belief(depth, seed, error=0.06, confidence=0.7):
    """Belief whose errors are of patches, as those by blur are."""
    random = np.random.default_rng(seed)
    patches = random.normal(size=(8, 10))
    errors = np.kron(patches, np.ones((15, 16)))
    inverse = (1 / depth * (1 + error * errors)).astype(np.float32)
    variance = np.square(error * inverse)
    return Belief(inverse, variance, np.full(depth.shape, confidence, np.float32))


def error_of(belief, depth):
    return float(np.mean(np.abs(1 / np.maximum(belief.inverse, 1e-3) / depth - 1)))


def walk(poses_given, way=WAY, **scene):
    """Steps of a memory along a way, and errors with it and by each frame alone."""
    memory = MovingMemory(VIEW, frames=8)
    steps, errors, alone = [], [], []
    for index, pose in enumerate(way):
        light, depth = seen(pose, **scene)
        own = blurred_belief(depth, index)
        given = None if poses_given is None else poses_given[index]
        steps.append(memory.add(light, own, given))
        errors.append(error_of(steps[-1].belief, depth))
        alone.append(error_of(own, depth))
    return steps, np.array(errors), np.array(alone)


def test_pose_and_parallax_make_depth_better():
    steps, errors, alone = walk(WAY)
    assert errors[-1] < 0.5 * alone[-1]
    assert not any(step.refused for step in steps)
    assert [step.begun for step in steps] == [True] + [False] * 7


@pytest.mark.parametrize("told", [WAY, None])
def test_the_exposure_may_change(told):
    memories = [MovingMemory(VIEW, frames=8) for _ in range(2)]
    for index, pose in enumerate(WAY):
        light, depth = seen(pose)
        own = blurred_belief(depth, index)
        given = None if told is None else told[index]
        factors = 1.0, np.float32(0.7 if index % 2 else 1.0)
        errors = [
            error_of(memory.add(factor * light, own, given).belief, depth)
            for memory, factor in zip(memories, factors, strict=True)
        ]
    assert errors[1] < 1.2 * errors[0]


def test_motion_is_found_in_the_frames():
    steps, errors, alone = walk(None)
    assert errors[-1] < 0.7 * alone[-1]
    found = np.linalg.inv(WAY[0]) @ WAY[-1]
    assert np.linalg.norm(steps[-1].pose[:3, 3] - found[:3, 3]) < 0.15 * np.linalg.norm(
        found[:3, 3]
    )
    assert np.abs(steps[-1].pose[:3, :3] - found[:3, :3]).max() < 0.02


def test_the_way_goes_on_where_a_frame_tells_nothing():
    steps, *_ = walk(WAY)
    way = Trajectory()
    places = [way.add(step) for step in steps]
    assert places[0] is None and way.lost == 0
    np.testing.assert_allclose(places[-1].pose, np.linalg.inv(WAY[0]) @ WAY[-1], atol=1e-9)
    step = np.linalg.inv(WAY[-2]) @ WAY[-1]
    np.testing.assert_allclose(places[-1].moved[:3], np.linalg.inv(step)[:3, 3] * -1, atol=1e-9)
    grown = [np.trace(place.covariance) for place in places[1:]]
    assert all(later > earlier for earlier, later in pairwise(grown))
    before = way.pose
    assert way.add(steps[0]) is None and way.lost == 1
    np.testing.assert_allclose(way.pose, before @ step, atol=1e-9)


def test_motion_between_two_frames_by_true_depth():
    first, depth = seen(WAY[0])
    second, _ = seen(WAY[4])
    images = [np.rint(255 * np.sqrt(light)).astype(np.uint8) for light in (first, second)]
    exact = Belief(1 / depth, np.full(depth.shape, 1e-8, np.float32), np.ones_like(depth))
    landmarks = Landmarks.of(images[0], exact)
    found = Found.of(landmarks, images[1], VIEW, np.eye(4))
    motion = found.motion(VIEW, np.eye(4))
    true = np.linalg.inv(WAY[4]) @ WAY[0]
    assert np.linalg.norm(motion.matrix[:3, 3] - true[:3, 3]) < 0.05 * np.linalg.norm(true[:3, 3])
    off = np.abs(motion.matrix[:3, 3] - true[:3, 3])
    assert (off < 6 * np.sqrt(np.diag(motion.covariance)[:3])).all()
    assert found.disagreement(true, VIEW) < 4 < found.disagreement(moved(0.1) @ true, VIEW)


@pytest.mark.parametrize("wrong", [moved(x=0.1), moved(yaw=np.radians(5))])
def test_a_wrong_pose_is_refused_and_forgotten(wrong):
    poses = [pose if index < 4 else pose @ wrong for index, pose in enumerate(WAY)]
    steps, errors, alone = walk(poses)
    assert [step.refused for step in steps[:5]] == [False] * 4 + [True]
    assert (errors[4:] < 0.9 * alone[4:]).all()


def turns(way):
    """Poses of which only the turn is known, as by a gyroscope that began some other way round."""
    found = [moved(yaw=0.7) @ pose for pose in way]
    for pose in found:
        pose[:3, 3] = np.nan
    return found


def test_turns_alone_help_to_find_the_motion():
    quick = [moved(0.03 * i, 0, 0, 0.2 * (i % 2)) for i in range(6)]
    found = np.linalg.inv(quick[0]) @ quick[-1]
    off = []
    for told in (turns(quick), None):
        steps, *_ = walk(told, way=quick)
        assert not any(step.refused for step in steps)
        off.append(np.abs(steps[-1].pose[:3, :3] - found[:3, :3]).max())
    assert off[0] < 0.01 and off[0] < off[1]


def test_turns_that_are_wrong_are_refused():
    told = turns([pose @ moved(yaw=0.1 * (index > 4)) for index, pose in enumerate(WAY)])
    steps, errors, alone = walk(told)
    assert [step.refused for step in steps] == [False] * 5 + [True] + [False] * 2
    assert (errors[5:] < 0.9 * alone[5:]).all()


def test_poses_of_the_frame_before_are_refused():
    steps, errors, alone = walk([WAY[0], *WAY[:-1]])
    assert steps[1].refused
    assert errors[3:].mean() < alone[3:].mean()


def test_a_missing_pose_is_found_in_the_frames():
    poses = [None if index in (3, 4) else pose for index, pose in enumerate(WAY)]
    steps, errors, alone = walk(poses)
    assert not any(step.begun or step.refused for step in steps[1:])
    assert errors[-1] < 0.5 * alone[-1]


def test_without_texture_every_frame_stands_for_itself():
    memory = MovingMemory(VIEW, frames=8)
    grey = np.full(VIEW.shape, 0.5, np.float32)
    for index in range(3):
        own = blurred_belief(np.full(VIEW.shape, 2.0, np.float32), index)
        step = memory.add(grey, own)
        assert step.begun
        np.testing.assert_array_equal(step.belief.inverse, own.inverse)


def test_what_moves_by_itself_is_forgotten():
    """A box comes into view before the wall: within three frames the box is believed."""
    memory = MovingMemory(VIEW, frames=8)
    for index, pose in enumerate(WAY):
        box = index >= 4
        light, depth = seen(pose, box=box)
        own = blurred_belief(depth, index)
        step = memory.add(light, own, pose)
        if index == 6:
            there = depth < 2
            assert there.sum() > 500
            assert error_of(Belief(*(m[there] for m in step.belief.maps)), depth[there]) < 0.1


def test_carried_depth_is_that_of_the_new_view():
    light, depth = seen(WAY[0], box=False)
    now, nearer = seen(moved(z=0.5), box=False)
    exact = Belief(1 / depth, np.full(depth.shape, 1e-6, np.float32), np.ones_like(depth))
    belief = carried(exact, light, now, VIEW, moved(z=-0.5), keep=0.9)
    known = belief.confidence > 0.1
    assert known.mean() > 0.8
    np.testing.assert_allclose(belief.inverse[known], 1 / nearer[known], rtol=1e-3)
    assert belief.confidence.max() <= 0.9


def test_what_is_nearer_hides_what_is_farther():
    """A box moves before the wall, in the view of a camera that goes to the side."""
    light, depth = seen(WAY[0])
    pose = moved(x=0.2)
    now, truth = seen(pose)
    exact = Belief(1 / depth, np.full(depth.shape, 1e-6, np.float32), np.ones_like(depth))
    belief = carried(exact, light, now, VIEW, np.linalg.inv(pose), keep=1.0)
    sure = belief.confidence > 0.5
    assert np.mean(np.abs(belief.inverse * truth - 1)[sure] < 0.02) > 0.98


def test_parallax_alone_corrects_an_error():
    light, _ = seen(WAY[0], box=False)
    pose = moved(x=0.15)
    now, truth = seen(pose, box=False)
    off = blurred_belief(truth * 1.05, 0, error=0.05)
    roots = [np.sqrt(each) for each in (light, now)]
    seen_before = Seen(roots[0], np.eye(4))
    told = Comparison.of(roots[1], seen_before, pose, VIEW, off, (0.0, 1.0)).told(off)
    sure = told.confidence > 0.5
    assert sure.mean() > 0.5
    assert np.median(np.abs(told.inverse * truth - 1)[sure]) < 0.01


def test_what_is_too_wide_ends_where_its_light_does():
    light, _ = seen(WAY[0])
    pose = moved(x=0.15)
    now, truth = seen(pose)
    wide = cv2.dilate((1 / truth).astype(np.float32), np.ones((5, 5), np.uint8))
    roots = [np.sqrt(each) for each in (light, now)]
    belief = Belief(wide, np.full(wide.shape, 1e-4, np.float32), np.ones_like(wide))
    frames = roots[1], Seen(roots[0], np.eye(4))
    ends = Comparison.of(*frames, pose, VIEW, belief, (0.0, 1.0)).settled(wide)
    off = [np.mean(np.abs(inverse * truth - 1) > 0.1) for inverse in (wide, ends)]
    assert off[1] < 0.7 * off[0]


def test_rows_may_be_shared_among_threads():
    light, _ = seen(WAY[0])
    pose = moved(x=0.15, y=0.05, yaw=0.02)
    now, truth = seen(pose)
    frames = np.sqrt(now), Seen(np.sqrt(light), np.eye(4))
    belief = blurred_belief(truth, 3)
    shared, alone = (
        with_parallax(belief, frames, pose, VIEW, (1e-3, 1.0), Workers(threads))
        for threads in (2, 1)
    )
    for first, second in zip(shared.maps, alone.maps, strict=True):
        np.testing.assert_allclose(first, second, rtol=1e-3, atol=1e-6)


def constant(inverse, variance, confidence):
    return Belief(
        *(np.full((2, 3), value, np.float32) for value in (inverse, variance, confidence))
    )


def test_two_beliefs_that_agree_are_surer_than_either():
    both = fused(constant(0.5, 1e-3, 0.7), constant(0.51, 1e-3, 0.7), 1.0)
    assert both.confidence.min() > 0.8
    assert 0.5 < both.inverse[0, 0] < 0.51
    assert both.variance.max() < 1e-3


def test_of_two_that_disagree_the_likelier_stands_and_is_less_sure():
    both = fused(constant(0.5, 1e-4, 0.9), constant(1.0, 1e-4, 0.6), 1.0)
    assert both.inverse[0, 0] == np.float32(0.5)
    assert both.confidence.max() < 0.9
    other = fused(constant(0.5, 1e-4, 0.6), constant(1.0, 1e-4, 0.9), 1.0)
    assert other.inverse[0, 0] == 1.0


@pytest.mark.parametrize("order", [(0.0, 0.6), (0.6, 0.0)])
def test_what_nobody_knows_changes_nothing(order):
    first, second = constant(0.3, 1e-3, order[0]), constant(0.7, 1e-3, order[1])
    both, known = fused(first, second, 1.0), first if order[0] else second
    for name in ("inverse", "variance", "confidence"):
        np.testing.assert_array_equal(getattr(both, name), getattr(known, name))


def test_what_frames_have_shown_to_be_free():
    """Behind no edge, only where all around is sure, and nearer than what is believed."""
    _, depth = seen(WAY[0])
    inverse, variance = (1 / depth).astype(np.float32), np.full(depth.shape, 1e-6, np.float32)
    sure = np.full(depth.shape, 0.95, np.float32)
    sure[:, :80] = 0.5
    clear = clearance_m(Belief(inverse, variance, sure))
    assert (clear[:, :84] == 0).all() and (clear[:, 85:] > 0).all()
    assert (clear < depth).all()
    assert clear[10, 150] > 0.9 * WALL_M
    beside_box = np.flatnonzero(depth[60] < 2)[-1] + 3
    assert depth[60, beside_box] > 2 and clear[60, beside_box] < BOX_M


CAMERA = Camera(150.0, 0.9, 160, 120, Mask.named("levin"), 60.0)


def test_views_of_a_region_and_of_binned_frames():
    whole = Pinhole.of_map(CAMERA, (120, 160))
    region = Pinhole.of_map(CAMERA.for_view(View(100, 80, 160, 120, 50.0, 30.0)), (80, 100))
    assert region.focal_px == pytest.approx(whole.focal_px)
    assert region.centre == pytest.approx(np.subtract(whole.centre, (50, 30)))
    binned = Pinhole.of_map(CAMERA.resized(80, 60), (60, 80))
    assert binned.focal_px == pytest.approx(np.divide(whole.focal_px, 2))
    assert binned.centre == pytest.approx((np.array(whole.centre) + 0.5) / 2 - 0.5)


@pytest.fixture(scope="module")
def bank():
    return learn_bank_for_camera(CAMERA, 1.2, 4.0, 15)


def test_the_stage_needs_metres_and_a_memory(bank):
    with pytest.raises(InputError, match="needs temporal_frames: more than 0"):
        DepthConfig(moving_camera="frames")
    config = DepthConfig(temporal_frames=8, moving_camera="frames")
    with pytest.raises(InputError, match="give a camera file"):
        DepthEstimator(bank, config).estimate(seen(WAY[0])[0])


@pytest.mark.parametrize("size", [None, (60, 80)])
@pytest.mark.parametrize("how", ["frames", "pose"])
def test_the_stage_in_the_estimator(bank, how, size):
    config = DepthConfig(temporal_frames=8, moving_camera=how, confidence_threshold=0.0)
    estimator = DepthEstimator(bank, config, CAMERA)
    for pose in WAY[:3]:
        estimate = estimator.estimate(Frame(seen(pose)[0], pose=lambda pose=pose: pose), size)
    assert estimate.depth_m.shape == (size or VIEW.shape)
    assert np.isfinite(estimate.level).all()
    assert (estimate.std_dev_m > 0).all()
    assert ((estimate.confidence >= 0) & (estimate.confidence <= 1)).all()
    estimator.reset()
    again = estimator.estimate(Frame(seen(WAY[0])[0], pose=lambda: WAY[0]), size)
    alone = DepthEstimator(
        bank, DepthConfig(temporal_frames=8, confidence_threshold=0.0), CAMERA
    ).estimate(Frame(seen(WAY[0])[0]), size)
    np.testing.assert_array_equal(again.level, alone.level)


def test_two_focus_settings(bank):
    config = DepthConfig(temporal_frames=8, moving_camera="frames", check_fit=False)
    pair = FocusPair(DepthEstimator(bank, config, CAMERA), 1.1)
    steps = [pair.estimate(*[seen(pose)[0]] * 2).camera_step for pose in WAY[:3]]
    assert [str(step) for step in steps[1:]] == ["found in the frames"] * 2


@pytest.fixture(scope="module")
def fine_bank():
    """A bank whose levels the refinement takes."""
    return learn_bank_for_camera(NARROW, 1.2, 4.0, 30)


NARROW = Camera(300.0, 0.9, 160, 120, Mask.named("levin"), 60.0)


def test_past_frames_make_more_of_the_space_free(fine_bank):
    """Frames are sharp here: only what the stage is handed counts."""
    config = DepthConfig(temporal_frames=8, moving_camera="pose", check_fit=False)
    levels = Levels.from_model(fine_bank, NARROW)
    work = DepthEstimator(fine_bank, config, NARROW).begin(Frame(seen(WAY[0])[0]))
    work.level = np.full((120, 160), 20.0, np.float32)
    work.doubted = np.zeros((120, 160), np.bool_)
    work.doubted[:60] = True
    work.decoded = types.SimpleNamespace(
        nearest_around=lambda share: np.full((120, 160), 10.0, np.float32)
    )
    depth_m = levels.depth_m(work.level)
    belief = Belief(*(np.full((60, 80), v, np.float32) for v in (1 / depth_m[0, 0], 1e-6, 0.95)))
    bounds = []
    for step in (None, Step(belief, np.eye(4), begun=True), Step(belief, np.eye(4))):
        work.camera_step = step
        FreeSpace(levels, 0.01)(work)
        bounds.append(work.layers["free_space"].values)
    np.testing.assert_array_equal(bounds[0], bounds[1])
    np.testing.assert_array_equal(bounds[0][:60], bounds[2][:60])
    assert (bounds[2][60:] > 1.1 * bounds[0][60:]).all()
    assert (bounds[2][60:] < depth_m[60:]).all()


@pytest.mark.parametrize(
    "beside",
    [
        {"free_space_risk": 0.01, "confidence_threshold": 0.6},
        {"second_surface": True, "confidence_threshold": 0.6},
        {"unknown": "nearest"},
        {"regularize": "semiglobal"},
        {"regularize": "learned", "confidence_threshold": 0.9},
    ],
)
def test_beside_other_options(fine_bank, beside):
    """Frames are sharp here, which the check of fit would not pass."""
    config = DepthConfig(temporal_frames=8, moving_camera="frames", check_fit=False, **beside)
    estimator = DepthEstimator(fine_bank, config, NARROW)
    for pose in WAY[:4]:
        estimate = estimator.estimate(Frame(seen(pose)[0]))
    assert str(estimate.camera_step) == "found in the frames"
    known = np.isfinite(estimate.depth_m)
    assert known.any() and known.all() == (beside.get("unknown") == "nearest")
    assert (estimate.std_dev_m[known] > 0).all()
    assert (estimate.confidence[known] >= config.confidence_threshold).all() or known.all()


def test_all_in_focus_frames_go_by_all_frames_so_far(fine_bank):
    config = DepthConfig(
        temporal_frames=8, moving_camera="frames", check_fit=False, confidence_threshold=0.0
    )
    pipeline = FramePipeline(fine_bank, NARROW, config, deblur=DeblurConfig(method="inverse"))
    for pose in WAY[:4]:
        frame = Frame(seen(pose)[0])
        estimate = pipeline(frame)
    alone = DepthEstimator(fine_bank, DepthConfig(confidence_threshold=0.0), NARROW).estimate(frame)
    used = pipeline.blur_size_px(frame, estimate)
    fused = NARROW.blur_size_px(1 / estimate.camera_step.belief.inverse)
    assert np.median(np.abs(used - fused)) < 0.1
    assert np.median(np.abs(used - alone.blur_size_px)) > 0.1
    assert pipeline.deblur(frame, estimate).shape == frame.shape


def stated(poses, deviation_m):
    """Poses whose covariance says that every step may be off by so much."""
    grown = np.diag([deviation_m**2] * 3 + [1e-10] * 3)
    return [Pose(pose, grown * index + 1e-6 * np.eye(6)) for index, pose in enumerate(poses)]


def stepping_off(deviation_m):
    """The way, each step of it off, as that of wheels on sand."""
    random, poses = np.random.default_rng(3), [WAY[0]]
    for before, after in pairwise(WAY):
        step = np.linalg.inv(before) @ after
        step[:3, 3] += deviation_m * random.normal(size=3)
        poses.append(poses[-1] @ step)
    return poses


def step_errors(steps):
    """Errors of the steps' lengths and directions, m, of the way."""
    true = [np.linalg.inv(WAY[0]) @ pose for pose in WAY]
    found = [step.pose for step in steps]
    return [
        np.linalg.norm((np.linalg.inv(a) @ b - np.linalg.inv(c) @ d)[:3, 3])
        for (a, b), (c, d) in zip(pairwise(found), pairwise(true), strict=True)
    ]


def test_landmarks_change_a_pose_within_its_covariance():
    off = stepping_off(0.01)
    unknown, *_ = walk(off)
    told, *_ = walk(stated(off, 0.01))
    assert np.mean(step_errors(told)) < 0.7 * np.mean(step_errors(unknown))
    assert all(step.told_by_pose for step in told[1:])


def test_a_pose_is_taken_at_its_word_where_it_is_sure():
    told, *_ = walk(stated(WAY, 0.0))
    assert max(step_errors(told)) < 2e-4
    exact, *_ = walk(WAY)
    np.testing.assert_allclose(told[-1].pose, exact[-1].pose, atol=1e-3)


def test_a_stated_jump_is_no_contradiction():
    jumped = [*WAY[:4], *(pose @ moved(x=0.1) for pose in WAY[4:])]
    grown = [0.0] * 4 + [0.1**2] * 4
    poses = [
        Pose(pose, 1e-6 * np.eye(6) + np.diag([more] * 3 + [0] * 3))
        for pose, more in zip(jumped, grown, strict=True)
    ]
    steps, errors, alone = walk(poses)
    assert not any(step.refused for step in steps)
    assert errors[4] < alone[4]
    assert walk(jumped)[0][4].refused


def test_what_a_motion_adds_is_not_what_poses_have_in_common():
    common = np.diag([4.0, 4.0, 4.0, 1e-4, 1e-4, 1e-4])
    turned = moved(x=1.0, yaw=np.pi / 2)
    lever = np.eye(6)
    lever[[1, 2], [5, 4]] = 1.0, -1.0  # turns about z and y move what is at x along y and z
    after = lever @ common @ lever.T + np.diag([0.04, 0, 0, 0, 0, 0.09])
    found = motion_covariance(Pose(np.eye(4), common), Pose(turned, after))
    # About the axes of the later view, which has x of the first along z.
    np.testing.assert_allclose(found, np.diag([0, 0, 0.04, 0.09, 0, 0]), atol=1e-9)
    shrunk = motion_covariance(Pose(np.eye(4), 2 * common), Pose(np.eye(4), common))
    np.testing.assert_allclose(shrunk, common, atol=1e-9)
    assert motion_covariance(Pose(np.eye(4)), Pose(turned, after)) is None


def test_what_is_carried_by_an_uncertain_motion_counts_less():
    light, depth = seen(WAY[0], box=False)
    sure = Belief(1 / depth, np.full(depth.shape, 1e-6, np.float32), np.ones_like(depth))
    exact, off = (
        carried(sure, light, light, VIEW, np.eye(4), 1.0, off_px) for off_px in (0.0, 1.0)
    )
    np.testing.assert_array_equal(exact.inverse, off.inverse)
    assert (off.variance > 5 * exact.variance).all()
    earlier = Seen(light, WAY[0])
    later, _ = seen(WAY[3], box=False)
    doubted = earlier.carried(np.eye(4), np.diag([0.02**2] * 3 + [0] * 3))
    spreads = [
        Comparison.of(later, each, WAY[3], VIEW, sure, (0.0, 1.0)).told(sure).variance
        for each in (earlier, doubted)
    ]
    assert np.median(spreads[1]) > 1.5 * np.median(spreads[0])
