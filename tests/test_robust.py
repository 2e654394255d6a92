"""The robust preset through the front door: what it gives back, what it says about it, and its symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import SKELETONS, TOLERANCE, clip, hit, lengths_of
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from motionrecover import PRESETS, Skeleton, corrupt, metrics, recover, synthesize
from motionrecover.evidence.bone_lengths import mirrored_bones
from motionrecover.evidence.contacts import find_contacts, foot_joints
from motionrecover.robust import Change

SKELETON = SKELETONS["cmu25"]
FRAMES = 96
TRUTH = clip(SKELETON, FRAMES)
LENGTHS = lengths_of(SKELETON, TRUTH)
HIT = hit(TRUTH, 0.2)


def error(found, truth=TRUTH):
    return np.linalg.norm(found.positions - truth, axis=-1)


@pytest.fixture(scope="module")
def found():
    return recover(HIT, SKELETON, dtype=np.float64)


def test_displaced_samples_are_repaired_and_the_others_untouched(found):
    displaced = np.any(HIT != TRUTH, -1)
    assert found.converged
    np.testing.assert_array_equal(found.positions[~displaced], TRUTH[~displaced])
    assert (found.changed[~displaced] == Change.UNTOUCHED).all()
    assert (found.changed[displaced] == Change.REPAIRED).mean() > 0.99
    assert error(found)[displaced].mean() < 2e-3
    assert found.weights[~displaced].min() > 0.5
    np.testing.assert_allclose(found.bone_lengths, LENGTHS, rtol=1e-4)
    assert ((found.bone_intervals[:, 0] <= LENGTHS) & (found.bone_intervals[:, 1] >= LENGTHS)).all()


def test_a_joint_thrown_among_coinciding_ones_is_repaired_alone():
    """Bones of no length, as in the BVH files of CMU: any of the doubles may be thrown, and two to one side."""
    wrist = SKELETON.names.index("lwrist")
    doubles = [len(SKELETON.names) + k for k in range(3)]
    skeleton = Skeleton([*SKELETON.names, "a", "b", "c"], [*SKELETON.edges, *((wrist, double) for double in doubles)])
    truth = np.concatenate([TRUTH, TRUTH[:, [wrist] * 3]], 1)
    data = hit(truth, 0.2)
    found = recover(data, skeleton, dtype=np.float64)
    displaced = np.any(data != truth, -1)
    few = displaced[:, [wrist, *doubles]].sum(1) < 3
    assert error(found, truth)[few][:, [wrist, *doubles]].max() < 2e-3
    assert (found.changed[displaced] == Change.REPAIRED).mean() > 0.99
    assert (found.changed[few][:, doubles][~displaced[few][:, doubles]] == Change.UNTOUCHED).all()
    assert found.weights[displaced].mean() < 0.01


def test_clean_clips_come_back_as_they_were():
    found = recover(TRUTH, SKELETON, dtype=np.float64)
    np.testing.assert_array_equal(found.positions, TRUTH)
    assert (found.changed == Change.UNTOUCHED).all()
    assert (found.uncertainty == 0).all()


def test_noise_is_smoothed_and_the_uncertainty_honest():
    noisy, _ = corrupt.noise(TRUTH, 0.003, 0)
    found = recover(noisy, SKELETON)
    assert (found.changed == Change.DENOISED).mean() > 0.99
    assert error(found).mean() < 0.55 * np.linalg.norm(noisy - TRUTH, axis=-1).mean()
    assert np.sqrt(np.mean(error(found) ** 2) / np.mean(found.uncertainty**2)) == pytest.approx(1, abs=0.25)


def test_gaps_are_filled_or_left():
    data = TRUTH.copy()
    data[30:60, 4] = np.nan
    found = recover(data, SKELETON)
    assert (found.changed[30:60, 4] == Change.FILLED).all()
    line = np.linalg.norm(
        TRUTH[29, 4] + np.linspace(0, 1, 32)[1:-1, None] * (TRUTH[60, 4] - TRUTH[29, 4]) - TRUTH[30:60, 4]
    )
    assert np.linalg.norm(error(found)[30:60, 4]) < 0.2 * line
    assert found.uncertainty[45, 4] > found.uncertainty[30, 4] > 0
    left = recover(data, SKELETON, max_gap=29)
    assert np.isnan(left.positions[30:60, 4]).all()
    assert np.isfinite(np.delete(left.positions, 4, 1)).all()
    assert (left.changed[30:60, 4] == Change.UNKNOWN).all()
    assert "max_gap" in left.message


def test_scattered_missing_samples_are_met_as_by_a_spline_or_better():
    """Points that move alone, and a body whose joints move together."""
    rng = np.random.default_rng(0)
    rates, phases = rng.uniform(2, 6, (2, 8, 3)), rng.uniform(0, 2 * np.pi, (2, 8, 3))
    time = np.arange(200)[:, None, None] / 60
    alone = 0.1 * np.sin(rates[0] * time + phases[0]) + 0.05 * np.sin(2 * rates[1] * time + phases[1])
    alone[..., 0] += 0.5 * np.arange(8)
    loose = Skeleton([f"s{k}" for k in range(8)], [])
    for truth, skeleton, most in ((alone, loose, 1.1), (TRUTH, SKELETON, 0.5)):
        missing = rng.random(truth.shape[:2]) < 0.1
        missing[[0, -1]] = False
        found = recover(np.where(missing[..., None], np.nan, truth), skeleton, dtype=np.float64)
        spline, frames = truth.copy(), np.arange(len(truth))
        for joint, gone in enumerate(missing.T):
            spline[gone, joint] = CubicSpline(frames[~gone], truth[~gone, joint])(frames[gone])
        assert error(found, truth)[missing].mean() < most * np.linalg.norm(spline - truth, axis=-1)[missing].mean()


def test_a_joint_never_seen_spoils_nothing_and_is_placed_when_asked():
    data = TRUTH.copy()
    data[:, 3] = np.nan
    found = recover(data, SKELETON, dtype=np.float64)
    assert np.isnan(found.positions[:, 3]).all()
    np.testing.assert_array_equal(np.delete(found.positions, 3, 1), np.delete(TRUTH, 3, 1))
    placed = recover(data, SKELETON, bone_lengths=LENGTHS, fill_unseen=True, dtype=np.float64)
    np.testing.assert_allclose(SKELETON.bone_lengths_of(placed.positions), np.tile(LENGTHS, (FRAMES, 1)), atol=1e-3)
    assert np.isfinite(placed.uncertainty[:, 3]).all()
    unnamed = Skeleton([f"joint {k}" for k in range(25)], SKELETON.edges)
    by_bones = recover(data, unnamed, bone_lengths=LENGTHS, fill_unseen=True, dtype=np.float64)
    np.testing.assert_allclose(SKELETON.bone_lengths_of(by_bones.positions), np.tile(LENGTHS, (FRAMES, 1)), atol=1e-3)
    assert np.isinf(by_bones.uncertainty[:, 3]).all()


@pytest.mark.parametrize("frames", [1, 2, 3, 6, 10])
def test_short_clips(frames):
    np.testing.assert_allclose(recover(TRUTH[:frames], SKELETON).positions, TRUTH[:frames], atol=1e-6)
    data = hit(TRUTH[:frames], 0.1, seed=3)
    found = recover(data, SKELETON, bone_lengths=LENGTHS)
    assert np.isfinite(found.positions).all()
    assert error(found, TRUTH[:frames]).mean() <= np.linalg.norm(data - TRUTH[:frames], axis=-1).mean() + 1e-6


def test_padding_changes_nothing(found):
    """Stored in 104 frames instead of 100."""
    other = recover(HIT, SKELETON, preset=replace(PRESETS["robust"], window=None), dtype=np.float64)
    np.testing.assert_allclose(other.positions, found.positions, atol=TOLERANCE["padding"] * np.std(TRUTH))


def test_thrown_rotations_are_repaired_though_bones_keep_their_lengths():
    """As in a BVH file: a joint turned wrongly takes along all that hangs from it."""
    rng, data = np.random.default_rng(0), TRUTH.copy()
    below = {child: [child] for _, child in SKELETON.edges}
    for parent, child in reversed(SKELETON.edges):
        if parent in below:
            below[parent] += below[child]
    for frame in range(2, FRAMES - 2, 6):
        joint = rng.choice([parent for parent, _ in SKELETON.edges if parent in below])
        moved = below[joint][1:]
        turned = (data[frame, moved] - data[frame, joint]) @ Rotation.random(random_state=rng).as_matrix()
        data[frame, moved] = data[frame, joint] + turned
    assert np.linalg.norm(data - TRUTH, axis=-1).mean() > 5e-3
    np.testing.assert_allclose(lengths_of(SKELETON, data), LENGTHS)
    assert error(recover(data, SKELETON, dtype=np.float64)).mean() < 1e-4


def test_a_rest_pose_before_the_motion_stays_and_spoils_nothing():
    pose = TRUTH[FRAMES // 2] + [0.2, 0.1, 0.0]
    found = recover(np.concatenate([pose[None], HIT[:-1]]), SKELETON, dtype=np.float64)
    np.testing.assert_array_equal(found.positions[0], pose)
    assert (found.changed[0] == Change.UNTOUCHED).all()
    assert error(found, np.concatenate([pose[None], TRUTH[:-1]])).mean() < 1e-3


def test_windows_leave_no_seams():
    motion = synthesize(8.0, seed=1)
    noisy, _ = corrupt.mixed(motion.positions, 0)
    parts = recover(noisy, motion.skeleton)
    assert len(motion.positions) > PRESETS["robust"].window
    assert np.isfinite(parts.positions).all()
    jump = np.linalg.norm(np.diff(parts.positions, 2, axis=0), axis=-1).mean(1)
    assert jump.max() < 3 * np.linalg.norm(np.diff(motion.positions, 2, axis=0), axis=-1).mean(1).max()
    assert error(parts, motion.positions).mean() < 0.006
    # Between two windows, and with gaps that reach over their ends, at least as good as alone.
    middle = slice(390, 590)
    alone = recover(noisy[middle], motion.skeleton)
    assert error(parts, motion.positions)[middle].mean() < 1.05 * error(alone, motion.positions[middle]).mean()


def test_symmetries(found):
    size = np.ptp(TRUTH)
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    turned = recover(HIT @ q.T + [5.0, -2.0, 9.0], SKELETON, dtype=np.float64).positions
    np.testing.assert_allclose(turned, found.positions @ q.T + [5.0, -2.0, 9.0], atol=1e-4 * size)
    scaled = recover(1000 * HIT, SKELETON, dtype=np.float64).positions
    np.testing.assert_allclose(scaled, 1000 * found.positions, atol=0.1 * size)
    order = np.random.default_rng(1).permutation(25)
    names = [SKELETON.names[j] for j in order]
    edges = [(SKELETON.names[i], SKELETON.names[j]) for i, j in SKELETON.edges]
    relabelled = recover(HIT[:, order], Skeleton(names, edges), dtype=np.float64).positions
    np.testing.assert_allclose(relabelled, found.positions[:, order], atol=1e-4 * size)


def test_what_nothing_speaks_for_stays_unknown():
    data = TRUTH.copy()
    data[40:60, 2:] = np.nan
    found = recover(data, SKELETON)
    assert np.isnan(found.positions[40:60, 2:]).all()
    assert np.isfinite(found.positions[40:60, :2]).all()
    assert "Recovered in part" in found.message
    white = recover(np.random.default_rng(0).normal(size=TRUTH.shape), SKELETON)
    assert np.isnan(white.positions).all()
    assert white.observed.all()
    assert not white.weights.any()
    assert "Recovered in part" in white.message


def test_swaps_are_put_right_and_reported():
    motion = synthesize(3.0, seed=2)
    left, right = (motion.names.index(name) for name in ("ltibia", "rtibia"))
    data, _ = corrupt.swap(motion.positions, [(left, right)], 40, 0)
    found = recover(data, motion.skeleton)
    assert [{swap.first_joint, swap.second_joint} for swap in found.swaps] == [{left, right}]
    assert error(found, motion.positions).max() < 0.01


def test_planted_feet_stay():
    motion = synthesize(4.0, seed=0)
    noisy, _ = corrupt.noise(motion.positions, 0.003, 0)
    feet = foot_joints(motion.skeleton)
    contacts = find_contacts(motion.positions, motion.fps, feet)
    plain, planted = (
        recover(noisy, motion.skeleton, fps=motion.fps, plant_feet=plant, dtype=np.float64) for plant in (False, True)
    )
    slide = [metrics.foot_slide(each.positions, contacts, feet, motion.fps) for each in (plain, planted)]
    assert slide[1] < 0.6 * slide[0]
    with pytest.raises(ValueError, match="fps"):
        recover(noisy, motion.skeleton, plant_feet=True)


def test_confidence_scales_trust():
    data = TRUTH + 0.003 * np.random.default_rng(0).normal(size=TRUTH.shape)
    data[::2, 5] += 0.01
    confidence = np.ones(TRUTH.shape[:2])
    confidence[::2, 5] = 0.05
    full, scaled = (recover(data, SKELETON, confidence=c, bone_lengths=LENGTHS) for c in (None, confidence))
    assert error(scaled)[:, 5].mean() < error(full)[:, 5].mean()
    assert scaled.weights[::2, 5].max() <= 0.05


@pytest.mark.parametrize("name", ["triangle", "braced"])
def test_general_graphs(name):
    skeleton = SKELETONS[name]
    truth = clip(skeleton, 60)
    data = hit(truth, 0.1)
    found = recover(data, skeleton)
    assert error(found, truth).mean() < 0.1 * np.linalg.norm(data - truth, axis=-1).mean()


def test_published_models_have_none_of_its_options():
    for options in ({"max_gap": 3}, {"fill_unseen": True}, {"plant_feet": True, "fps": 30}, {"symmetric": True}):
        with pytest.raises(ValueError, match="options of robust"):
            recover(HIT, SKELETON, preset="str_yang2020", **options)


def test_symmetric_draws_left_and_right_bones_together():
    motion = synthesize(0.8, seed=4)
    noisy, _ = corrupt.noise(motion.positions, 0.01, 2)
    pairs = np.transpose(mirrored_bones(motion.skeleton))
    apart, together = (
        np.abs(np.subtract(*recover(noisy, motion.skeleton, symmetric=symmetric).bone_lengths[pairs])).mean()
        for symmetric in (False, True)
    )
    assert together < 0.8 * apart
    given = recover(noisy, motion.skeleton, symmetric=True, bone_lengths=lengths_of(motion.skeleton, motion.positions))
    np.testing.assert_array_equal(given.bone_lengths, lengths_of(motion.skeleton, motion.positions))
