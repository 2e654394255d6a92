import numpy as np
import pytest

from motionrecover import Skeleton, corrupt

CLEAN = np.random.default_rng(99).normal(size=(1200, 20, 3)).cumsum(0) / 100

CHAIN = Skeleton([f"left{k}" for k in range(10)] + [f"right{k}" for k in range(10)], [(k, k + 1) for k in range(19)])

MODELS = {
    "joints": lambda positions, seed: corrupt.joints(positions, 0.2, seed=seed),
    "entries": lambda positions, seed: corrupt.entries(positions, 0.2, seed=seed),
    "missing": lambda positions, seed: corrupt.missing(positions, 0.3, seed),
    "gaps": lambda positions, seed: corrupt.gaps(positions, 3, 60, seed),
    "real_gaps": lambda positions, seed: corrupt.real_gaps(positions, 0.1, seed),
    "mixed": corrupt.mixed,
    "noise": lambda positions, seed: corrupt.noise(positions, 0.01, seed),
    "swap": lambda positions, seed: corrupt.swap(positions, [(0, 1), (4, 9)], 30, seed),
    "swaps": lambda positions, seed: corrupt.swaps(positions, CHAIN, 4, 30, seed),
    "drift": lambda positions, seed: corrupt.drift(positions, 2, seed=seed),
    "kinect": corrupt.kinect,
}
DENSE = ("noise", "mixed", "kinect")


def run_lengths(mask):
    """Lengths of the runs of True in each column, in one array."""
    padded = np.pad(mask.astype(int), ((1, 1), (0, 0)))
    steps = np.diff(padded, axis=0).T
    return np.nonzero(steps == -1)[1] - np.nonzero(steps == 1)[1]


def sizes(corrupted, clean=CLEAN):
    return np.linalg.norm(corrupted - clean, axis=-1)


@pytest.mark.parametrize("name", MODELS)
def test_seeds_fix_the_answer_and_the_input_stays(name):
    clean = CLEAN.copy()
    corrupted, hit = MODELS[name](clean, 3)
    again, hit_again = MODELS[name](clean, np.random.default_rng(3))
    other, _ = MODELS[name](clean, 4)
    np.testing.assert_array_equal(clean, CLEAN)
    np.testing.assert_array_equal(corrupted, again)
    np.testing.assert_array_equal(hit, hit_again)
    assert not np.array_equal(corrupted, other, equal_nan=True)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", MODELS)
def test_dtype_is_kept_and_samples_that_were_not_hit_too(name, dtype):
    clean = CLEAN.astype(dtype)
    corrupted, hit = MODELS[name](clean, 0)
    assert (corrupted.dtype, corrupted.shape) == (dtype, clean.shape)
    assert (hit.dtype, hit.shape) == (bool, clean.shape[:2])
    assert np.isfinite(corrupted[~hit]).all()
    if name not in DENSE:
        np.testing.assert_array_equal(corrupted[~hit], clean[~hit])
        assert (corrupted[hit] != clean[hit]).any(-1).all()


@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("swap", "swaps")])
def test_missing_samples_stay_missing_and_are_no_hits(name):
    holed = CLEAN.copy()
    holed[100:300, :5] = np.nan
    corrupted, hit = MODELS[name](holed, 0)
    assert np.isnan(corrupted[100:300, :5]).all()
    assert not hit[100:300, :5].any()
    assert np.isfinite(corrupted[~hit & np.isfinite(holed).all(-1)]).all()


@pytest.mark.parametrize("fraction", [0.05, 0.2, 0.8])
def test_joints(fraction):
    corrupted, hit = corrupt.joints(CLEAN, fraction, seed=1)
    assert hit.mean() == pytest.approx(fraction, abs=0.01)
    moved = (corrupted - CLEAN)[hit]
    assert np.abs(moved).max() <= 0.25
    assert np.abs(moved).max() > 0.24
    np.testing.assert_allclose(moved.std(0), 0.5 / 12**0.5, rtol=0.05)


def test_entries_strike_single_coordinates():
    corrupted, hit = corrupt.entries(CLEAN, 0.2, amplitude=0.1, seed=1)
    moved = corrupted - CLEAN
    assert (moved != 0).mean() == pytest.approx(0.2, abs=0.01)
    assert hit.mean() == pytest.approx(1 - 0.8**3, abs=0.01)
    assert 0.099 < np.abs(moved).max() <= 0.1


def test_missing():
    corrupted, hit = corrupt.missing(CLEAN, 0.3, seed=1)
    assert hit[1:-1].mean() == pytest.approx(0.3, abs=0.01)
    assert not hit[[0, -1]].any()
    np.testing.assert_array_equal(np.isnan(corrupted).all(-1), hit)


def test_gaps():
    corrupted, hit = corrupt.gaps(CLEAN, joints=5, frames=60, seed=1)
    assert hit.any(0).sum() == 5
    assert run_lengths(hit).tolist() == [60] * 5
    assert not hit[: corrupt.GAP_MARGIN].any()
    assert not hit[-corrupt.GAP_MARGIN :].any()
    assert len({tuple(column) for column in hit.T[hit.any(0)]}) == 5
    np.testing.assert_array_equal(np.isnan(corrupted).all(-1), hit)


def test_gaps_fit_exactly_and_no_shorter():
    _, hit = corrupt.gaps(CLEAN[:100], 20, 60)
    assert hit[20:80].all()
    with pytest.raises(ValueError, match=r"a clip of 99 frames: a gap of 60 .* needs 100"):
        corrupt.gaps(CLEAN[:99], 1, 60)
    with pytest.raises(ValueError, match="gaps in 21 joints: the clip has 20"):
        corrupt.gaps(CLEAN, 21, 60)


def test_real_gaps_follow_their_quantiles():
    tall = np.zeros((20000, 30, 3))
    _, hit = corrupt.real_gaps(tall, 0.15, seed=1)
    assert hit.sum() == round(0.15 * hit.size)
    lengths = run_lengths(hit)
    for length, share in ((6, 0.5), (26, 0.75), (104, 0.9), (296, 0.95), (998, 0.99)):
        assert (lengths <= length).mean() == pytest.approx(share, abs=0.03)
    assert not hit[[0, -1]].any()


@pytest.mark.parametrize("frames", [2, 3, 5, 40])
def test_runs_fit_short_clips(frames):
    for model in (corrupt.real_gaps, corrupt.mixed, corrupt.kinect):
        _, hit = model(CLEAN[:frames], seed=0)
        assert hit.shape == (frames, 20)
    assert not np.isnan(corrupt.real_gaps(CLEAN[:frames])[0][[0, -1]]).any()


def test_real_gaps_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="do not hold separate runs"):
        corrupt.real_gaps(CLEAN[:50], 0.99)


def test_mixed():
    corrupted, hit = corrupt.mixed(CLEAN, seed=1)
    lost = np.isnan(corrupted).all(-1)
    assert lost.mean() == pytest.approx(0.1, abs=31 / lost.size)
    assert run_lengths(lost).min() >= 30
    assert run_lengths(lost).max() <= 120
    assert not lost[[0, -1]].any()
    assert hit[lost].all()
    thrown = hit & ~lost
    assert thrown[~lost].mean() == pytest.approx(0.02, abs=0.004)
    far = sizes(corrupted)
    assert far[thrown].min() > 0.06 - 0.015
    assert far[thrown].max() < 0.25 + 0.015
    assert far[thrown].max() - far[thrown].min() > 0.15
    np.testing.assert_allclose((corrupted - CLEAN)[~hit].std(0), 0.003, rtol=0.05)


def test_noise():
    corrupted, hit = corrupt.noise(CLEAN, 0.01, seed=1)
    assert not hit.any()
    np.testing.assert_allclose((corrupted - CLEAN).std((0, 1)), 0.01, rtol=0.03)


def test_swap():
    corrupted, hit = corrupt.swap(CLEAN, [(2, 7), (3, 8)], frames=50, seed=1)
    assert sorted(np.flatnonzero(hit.any(0))) == [2, 3, 7, 8]
    assert run_lengths(hit).tolist() == [50] * 4
    for left, right in ((2, 7), (3, 8)):
        run = hit[:, left]
        np.testing.assert_array_equal(run, hit[:, right])
        np.testing.assert_array_equal(corrupted[run, left], CLEAN[run, right])
        np.testing.assert_array_equal(corrupted[run, right], CLEAN[run, left])


def test_swap_moves_gaps():
    holed = CLEAN[:50].copy()
    holed[:, 0] = np.nan
    corrupted, hit = corrupt.swap(holed, [(0, 1)], frames=50)
    assert hit[:, :2].all()
    assert np.isnan(corrupted[:, 1]).all()
    assert np.isfinite(corrupted[:, 0]).all()


def test_swaps_draw_bones_and_sides_without_common_joints():
    drawn = set()
    for seed in range(100):
        corrupted, hit = corrupt.swaps(CLEAN, CHAIN, 3, 20, seed)
        joints = np.flatnonzero(hit.any(0))
        assert len(joints) == 6
        assert run_lengths(hit).tolist() == [20] * 6
        for joint in joints:
            run = hit[:, joint]
            other = next(k for k in joints if np.array_equal(corrupted[run, joint], CLEAN[run, k]))
            drawn.add((min(joint, other), max(joint, other)))
    assert drawn == {*CHAIN.edges, *CHAIN.mirror}


@pytest.mark.parametrize("pairs", [[(1, 1)], [(0, 20)], [(-1, 2)], [(0, 1, 2)]])
def test_swap_refuses_pairs_that_are_none(pairs):
    with pytest.raises(ValueError, match="pairs of different joint indices from 0 to 19"):
        corrupt.swap(CLEAN, pairs, 10)


def test_swap_refuses_long_runs():
    with pytest.raises(ValueError, match="a swap of 1201 frames: the clip has 1200"):
        corrupt.swap(CLEAN, [(0, 1)], 1201)


def test_drift_is_slow_and_as_far_as_asked():
    corrupted, hit = corrupt.drift(CLEAN, joints=4, amplitude=0.1, seed=1)
    assert hit.all(0).sum() == hit.any(0).sum() == 4
    wander = (corrupted - CLEAN)[:, hit.any(0)]
    np.testing.assert_allclose(np.linalg.norm(wander, axis=-1).max(0), 0.1)
    assert np.linalg.norm(np.diff(wander, axis=0), axis=-1).max() < 0.01
    with pytest.raises(ValueError, match="a drift of 21 joints"):
        corrupt.drift(CLEAN, 21)


def test_kinect_jitters_more_at_speed_and_holds_joints():
    still, fast = np.zeros((2000, 10, 3)), np.zeros((2000, 10, 3))
    fast[:, :, 0] = 0.05 * np.arange(2000)[:, None]
    spreads = []
    for clean in (still, fast):
        corrupted, hit = corrupt.kinect(clean, seed=1)
        assert hit.mean() == pytest.approx(0.08, abs=0.002)
        assert run_lengths(hit).max() <= 30
        spreads.append((corrupted - clean)[~hit].std())
    np.testing.assert_allclose(spreads, [0.004, 0.009], rtol=0.05)
    corrupted, hit = corrupt.kinect(fast, seed=1)
    lag = (fast - corrupted)[..., 0]
    assert lag[hit].mean() > 0.3
    assert np.median(np.abs(lag[~hit])) < 0.01


def test_protocols_by_name():
    for name, expected in {
        "iid-20": corrupt.joints(CLEAN, 0.2, seed=5),
        "entries-5": corrupt.entries(CLEAN, 0.05, seed=5),
        "rand30": corrupt.missing(CLEAN, 0.3, 5),
        "gap3x60": corrupt.gaps(CLEAN, 3, 60, 5),
        "real-gaps": corrupt.real_gaps(CLEAN, 0.1, 5),
        "real-gaps-20": corrupt.real_gaps(CLEAN, 0.2, 5),
        "swap2x30": corrupt.swaps(CLEAN, CHAIN, 2, 30, 5),
        "mixed": corrupt.mixed(CLEAN, 5),
        "kinect": corrupt.kinect(CLEAN, 5),
    }.items():
        corrupted, hit = corrupt.apply(name, CLEAN, 5, CHAIN)
        np.testing.assert_array_equal(corrupted, expected[0])
        np.testing.assert_array_equal(hit, expected[1])


@pytest.mark.parametrize("name", ["iid", "iid-", "iid-2x", "gap3", "rand30 ", "Mixed", "", "iid-F"])
def test_unknown_protocols_are_refused(name):
    with pytest.raises(ValueError, match=r"give one of iid-F, .*gapNxL.*mixed"):
        corrupt.apply(name, CLEAN)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: corrupt.joints(CLEAN, 1.5), "fraction of 1.5: give one from 0 to 1"),
        (lambda: corrupt.missing(CLEAN, -0.1), "fraction = -0.1"),
        (lambda: corrupt.missing(CLEAN, np.nan), "fraction = nan"),
        (lambda: corrupt.joints(CLEAN, 0.5, amplitude=-1), "amplitude = -1"),
        (lambda: corrupt.gaps(CLEAN, 0, 5), "joints = 0: give a whole number"),
        (lambda: corrupt.gaps(CLEAN, 1, 2.5), "frames = 2.5: give a whole number"),
        (lambda: corrupt.drift(CLEAN, period=0), "period = 0"),
        (lambda: corrupt.noise(CLEAN[0], 0.1), r"shape \(20, 3\)"),
        (lambda: corrupt.noise(np.zeros((5, 2, 3), int), 0.1), "dtype int64: give floats"),
        (lambda: corrupt.swaps(CLEAN, CHAIN, 0, 5), "pairs = 0: give a whole number"),
        (lambda: corrupt.swaps(CLEAN, CHAIN, 11, 5), "swaps of 11 pairs"),
        (lambda: corrupt.apply("swap2x30", CLEAN), "'swap2x30' without a skeleton"),
        (lambda: corrupt.apply("iid-200", CLEAN), "fraction of 2.0"),
    ],
)
def test_arguments_out_of_range_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
