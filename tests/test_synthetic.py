import numpy as np
import pytest

from motionrecover.runs import runs_of
from motionrecover.skeleton import Skeleton
from motionrecover.synthetic import GRAVITY, synthesize

SEEDS = (0, 1, 7)


@pytest.fixture(scope="module", params=SEEDS)
def clip(request):
    return synthesize(seed=request.param)


def track(clip, joint):
    return clip.positions[:, clip.names.index(joint)]


def test_bones_are_rigid_and_as_long_as_the_rest_pose_says(clip):
    lengths = clip.skeleton.bone_lengths_of(clip.positions)
    assert np.abs(lengths - clip.skeleton.rest_lengths).max() < 1e-12


def test_skeleton_is_cmu25(clip):
    standard = Skeleton.standard("cmu25")
    assert (clip.names, clip.skeleton.edges) == (standard.names, standard.edges)
    assert 1.6 < track(clip, "head")[0, 1] < 1.85
    assert clip.positions.dtype == np.float64
    assert clip.observed.all()


@pytest.mark.parametrize("side", "lr")
def test_planted_feet_do_not_slide(clip, side):
    ball = track(clip, f"{side}foot")
    planted = ball[:, 1] < ball[:, 1].min() + 1e-4
    runs = runs_of(planted)
    assert len(runs) >= 4
    assert planted.mean() > 0.4
    assert max(np.ptp(ball[start:end], axis=0).max() for start, end in runs) < 1e-3


@pytest.mark.parametrize("side", "lr")
def test_ankle_rests_while_the_foot_is_flat(clip, side):
    ankle, ball = track(clip, f"{side}tibia"), track(clip, f"{side}foot")
    flat = (ball[:, 1] < ball[:, 1].min() + 1e-4) & (ankle[:, 1] < ankle[:, 1].min() + 1e-4)
    speed = np.linalg.norm(np.diff(ankle, axis=0), axis=-1)[flat[1:] & flat[:-1]] * clip.fps
    assert len(speed) > 0.2 * len(clip)
    assert speed.max() < 0.05
    assert np.median(speed) < 1e-9


def test_somebody_carries_the_weight_except_in_the_jump(clip):
    aloft = np.minimum(track(clip, "lfoot")[:, 1], track(clip, "rfoot")[:, 1]) > 0.03
    ((start, end),) = runs_of(aloft)
    assert 0.3 < (end - start) / clip.fps < 0.7
    assert track(clip, "lfoot")[aloft, 1].max() > 0.2


def test_pelvis_flies_under_gravity(clip):
    aloft = np.minimum(track(clip, "lfoot")[:, 1], track(clip, "rfoot")[:, 1]) > 0.2
    fall = np.diff(track(clip, "root")[aloft, 1], 2) * clip.fps**2
    np.testing.assert_allclose(fall, -GRAVITY, atol=0.2)


def test_nobody_is_below_the_floor(clip):
    assert clip.positions[..., 1].min() > 0


def test_knees_bend_forward_and_elbows_do_too(clip):
    hips = track(clip, "lhipjoint") - track(clip, "rhipjoint")
    ahead = np.cross(hips, [0, 1, 0])
    for side in "lr":
        hip, knee, ankle = (track(clip, side + joint) for joint in ("hipjoint", "femur", "tibia"))
        # The knee lies on the front side of the line from hip to ankle, in the plane across the hips.
        line = ankle - hip
        front = np.cross(line, hips)
        assert ((knee - hip) * front).sum(-1).min() > 0
    facing = track(clip, "lfoot") - track(clip, "ltibia")
    assert ((facing * ahead).sum(-1) > 0).mean() > 0.9


def test_arms_swing_against_the_legs(clip):
    walk = slice(round(0.8 * clip.fps), round(2.2 * clip.fps))
    legs = (track(clip, "lfoot") - track(clip, "rfoot"))[walk, 2]
    arms = (track(clip, "lwrist") - track(clip, "rwrist"))[walk, 2]
    assert np.corrcoef(legs, arms)[0, 1] < -0.9


def test_accelerations_are_human(clip):
    acceleration = np.linalg.norm(np.diff(clip.positions, 2, axis=0), axis=-1) * clip.fps**2
    assert acceleration.max() < 150
    assert acceleration.max() > 40
    assert track(clip, "root")[:, 1].min() > 0.5


@pytest.mark.parametrize("seed", range(20, 40))
def test_every_seed_makes_a_finite_clip(seed):
    assert np.isfinite(synthesize(20, 30, seed).positions).all()


@pytest.mark.parametrize(("seconds", "fps", "frames"), [(8, 120, 960), (0.01, 120, 1), (1.5, 29.97, 45), (30, 25, 750)])
def test_seconds_and_fps_are_kept(seconds, fps, frames):
    clip = synthesize(seconds, fps, 3)
    assert (len(clip), clip.fps) == (frames, fps)


def test_a_short_clip_is_the_beginning_of_a_long_one():
    long, short = synthesize(6, 60, 4), synthesize(2.5, 60, 4)
    np.testing.assert_allclose(short.positions, long.positions[: len(short)], atol=1e-12)


def test_a_seed_fixes_the_clip_and_another_changes_it():
    first, again, other = (synthesize(2, 60, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.positions, again.positions)
    assert np.abs(first.positions - other.positions).max() > 0.01


@pytest.mark.parametrize(("seconds", "fps"), [(0, 120), (8, 0), (-1, 120), (np.nan, 120), (8, np.inf)])
def test_durations_without_a_frame_are_refused(seconds, fps):
    with pytest.raises(ValueError, match="at least one frame"):
        synthesize(seconds, fps)
