import numpy as np
import pytest

from motionrecover import metrics
from motionrecover.skeleton import Skeleton

SKELETON = Skeleton.from_parents("abcd", [-1, 0, 1, 1])


@pytest.fixture
def pair():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(9, 4, 3))
    return truth + rng.normal(scale=0.1, size=truth.shape), truth, rng.random((9, 4)) < 0.8


def test_aje_by_hand():
    truth = np.zeros((2, 2, 3))
    recovered = truth.copy()
    recovered[0, 0] = 3, 4, 0
    assert metrics.aje(recovered, truth) == 5 / 4
    assert metrics.aje(recovered, truth, [[True, False], [True, False]]) == 5 / 2


def test_aje_against_loops(pair):
    recovered, truth, mask = pair
    errors = [
        sum((recovered[t, s, k] - truth[t, s, k]) ** 2 for k in range(3)) ** 0.5
        for t in range(9)
        for s in range(4)
        if mask[t, s]
    ]
    assert metrics.aje(recovered, truth, mask) == pytest.approx(np.mean(errors), rel=1e-13)


def test_abe_against_loops(pair):
    recovered, truth, mask = pair
    total, counted = 0.0, []
    for t in range(9):
        for i, j in SKELETON.edges:
            found = np.linalg.norm(recovered[t, i] - recovered[t, j])
            error = abs(found - np.linalg.norm(truth[t, i] - truth[t, j]))
            total += error
            counted += [error] if mask[t, i] and mask[t, j] else []
    assert metrics.abe(recovered, truth, SKELETON) == pytest.approx(total / (9 * 3), rel=1e-13)
    assert metrics.abe(recovered, truth, SKELETON.edges, mask) == pytest.approx(np.mean(counted), rel=1e-13)


def test_abe_takes_lengths_of_bones_and_of_frames(pair):
    recovered, truth, _ = pair
    lengths = SKELETON.bone_lengths_of(truth)
    assert metrics.abe(recovered, lengths, SKELETON) == metrics.abe(recovered, truth, SKELETON)
    steady = np.full(3, 1.5)
    errors = metrics.bone_length_error(recovered, SKELETON, steady)
    np.testing.assert_allclose(errors, np.abs(SKELETON.bone_lengths_of(recovered) - 1.5), rtol=1e-14)
    assert metrics.abe(recovered, steady, SKELETON) == pytest.approx(errors.mean())


def test_accelerations_against_loops(pair):
    recovered, truth, mask = pair
    found, true, error = [], [], []
    for t in range(1, 8):
        for s in range(4):
            if mask[t - 1 : t + 2, s].all():
                a, b = (x[t - 1, s] - 2 * x[t, s] + x[t + 1, s] for x in (recovered, truth))
                found.append(np.linalg.norm(a))
                true.append(np.linalg.norm(b))
                error.append(np.linalg.norm(a - b))
    ratio = metrics.acceleration_ratio(recovered, truth, mask)
    assert ratio == pytest.approx(np.mean(found) / np.mean(true), rel=1e-12)
    assert metrics.acceleration_error(recovered, truth, 30, mask) == pytest.approx(900 * np.mean(error), rel=1e-12)


def test_jitter_of_a_cubic_is_its_third_derivative():
    time = np.arange(50) / 100
    positions = np.zeros((50, 1, 3))
    positions[:, 0, 1] = 7 * time**3
    assert metrics.jitter(positions, fps=100) == pytest.approx(42, rel=1e-6)
    mask = np.ones((50, 1), bool)
    mask[10] = False
    positions[10] = np.nan
    assert metrics.jitter(positions, 100, mask) == pytest.approx(42, rel=1e-6)


def test_nan_counts_only_where_the_mask_says(pair):
    recovered, truth, mask = pair
    measures = [
        lambda x, m: metrics.aje(x, truth, m),
        lambda x, m: metrics.abe(x, truth, SKELETON, m),
        lambda x, m: metrics.acceleration_ratio(x, truth, m),
        lambda x, m: metrics.acceleration_error(x, truth, 1, m),
        lambda x, m: metrics.jitter(x, 1, m),
    ]
    holed = np.where(mask[..., None], recovered, np.nan)
    for measure in measures:
        assert measure(holed, mask) == measure(recovered, mask)
        assert type(measure(recovered, None)) is float
        assert np.isnan(measure(holed, None))
        assert np.isnan(measure(recovered, np.zeros_like(mask)))


def test_perfect_recovery(pair):
    _, truth, _ = pair
    assert metrics.aje(truth, truth) == metrics.abe(truth, truth, SKELETON) == 0
    assert metrics.acceleration_ratio(truth, truth) == 1
    assert metrics.acceleration_error(truth, truth, 120) == 0


def test_too_short_or_still_clips_have_no_acceleration():
    assert np.isnan(metrics.acceleration_ratio(np.zeros((2, 1, 3)), np.zeros((2, 1, 3))))
    assert np.isnan(metrics.acceleration_ratio(np.zeros((9, 1, 3)), np.zeros((9, 1, 3))))
    assert np.isnan(metrics.jitter(np.zeros((1, 1, 3)), 30))


def test_float32_is_measured_in_float64():
    truth = np.full((1000, 1, 3), 1000, np.float32)
    assert metrics.aje(truth + np.float32(0.5), truth) == pytest.approx(0.75**0.5, rel=1e-14)


def test_foot_slide_is_the_horizontal_speed_of_planted_steps():
    positions = np.zeros((5, 2, 3))
    positions[:, 1] = np.array([0.0, 1, 3, 6, 10])[:, None] * (0.03, 7, 0.04)  # steps of 5, 10, 15, 20 cm on the floor
    contacts = np.array([[False], [True], [True], [True], [False]])
    assert metrics.foot_slide(positions, contacts, [1], 10) == pytest.approx((1.0 + 1.5) / 2)
    assert metrics.foot_slide(positions[..., [1, 0, 2]], contacts, [1], 10, up="x") == pytest.approx(1.25)
    assert metrics.skating_ratio(positions, contacts, [1], 10, limit=1.2) == 0.5
    assert metrics.foot_slide(positions, contacts, [0], 10) == metrics.skating_ratio(positions, contacts, [0], 10) == 0
    positions[3] = np.nan
    for measure in (metrics.foot_slide, metrics.skating_ratio):
        assert np.isnan(measure(positions, contacts, [1], 10))
        assert np.isnan(measure(positions, ~contacts, [1], 10))
    with pytest.raises(ValueError, match="received contacts of shape"):
        metrics.foot_slide(positions, contacts, [0, 1], 10)


def test_misshapen_arguments_are_refused(pair):
    recovered, truth, mask = pair
    with pytest.raises(ValueError, match="same frames and joints"):
        metrics.aje(recovered[:-1], truth)
    with pytest.raises(ValueError, match="give \\(frame, joint, 3\\)"):
        metrics.jitter(recovered[..., :2], 30)
    with pytest.raises(ValueError, match="received a mask of shape"):
        metrics.aje(recovered, truth, mask[:, :2])
    with pytest.raises(ValueError, match="received bone lengths of shape"):
        metrics.abe(recovered, np.ones(2), SKELETON)
    with pytest.raises(ValueError, match="more joints than the 4"):
        metrics.abe(recovered, truth, [(0, 4)])
