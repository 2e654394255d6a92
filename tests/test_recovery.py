"""The front door: what it accepts, what it refuses in one sentence, and the symmetries of its answers."""

from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import GRAPHS, SKELETONS, TOLERANCE, clip, hit, lengths_of

from motionrecover import PRESETS, Recovery, RecoveryError, Skeleton, metrics, recover, synthesize
from motionrecover.intake import fill, matrix_from, positions_from

published = partial(recover, preset="str_yang2020")
SKELETON = SKELETONS["cmu25"]
FRAMES = 64
TRUTH = clip(SKELETON, FRAMES)
LENGTHS = lengths_of(SKELETON, TRUTH)
HIT = hit(TRUTH, 0.1)


def settled(data, skeleton=SKELETON, lengths=LENGTHS, preset="str_yang2020", **changes) -> Recovery:
    """A recovery run to its end in float64, so that only a difference of the model can show."""
    preset = replace(PRESETS[preset], tolerance=1e-7, max_steps=5000, **changes)
    return recover(data, skeleton, preset=preset, bone_lengths=lengths, dtype=np.float64)


@pytest.fixture(scope="module")
def plain() -> Recovery:
    return settled(HIT)


# Share of the corruption that each model may leave on this clip; the three measured 0.46, 0.22 and 0.19.
@pytest.mark.parametrize(
    ("preset", "left"), [("lowrank_wang2016", 0.5), ("isometry_li2017", 0.25), ("str_yang2020", 0.25)]
)
def test_recovers_a_corrupted_clip(preset, left):
    found = recover(HIT, SKELETON, preset=preset, bone_lengths=LENGTHS, fps=120.0)
    assert found.converged, found.message
    assert metrics.aje(found.positions, TRUTH) < left * metrics.aje(HIT, TRUTH)
    assert found.positions.shape == found.outliers.shape == (FRAMES, 25, 3)
    assert found.matrix.shape == (3 * FRAMES, 25)
    assert found.positions.dtype == found.matrix.dtype == np.float32
    assert found.weights.shape == found.observed.shape == (FRAMES, 25)
    assert ((found.weights >= 0) & (found.weights <= 1)).all()
    assert found.observed.all()
    assert found.fps == 120.0
    assert set(found.seconds) == {"compile", "run"}
    # D = A + E, and the samples that were thrown are the ones that are not trusted.
    np.testing.assert_allclose(found.positions + found.outliers, HIT, atol=5e-3)
    thrown = np.linalg.norm(HIT - TRUTH, axis=-1) > 0.1
    assert found.weights[thrown].mean() < 0.2 < 0.8 < found.weights[~thrown].mean()


def test_every_form_of_the_data_gives_the_same_answer():
    forms = [HIT, matrix_from(HIT), jnp.asarray(HIT), HIT.tolist()]
    answers = [published(form, SKELETON, bone_lengths=LENGTHS).positions for form in forms]
    for answer in answers[1:]:
        np.testing.assert_array_equal(answer, answers[0])


def test_matrix_is_the_papers():
    matrix = matrix_from(TRUTH)
    np.testing.assert_array_equal(matrix[3:6, 7], TRUTH[1, 7])  # rows x, y, z of frame 2, column of joint 8
    np.testing.assert_array_equal(positions_from(matrix), TRUTH)


def test_translation(plain):
    shift = np.array([10.0, -3.0, 0.5])
    moved = settled(HIT + shift)
    np.testing.assert_allclose(moved.positions - shift, plain.positions, atol=TOLERANCE["equivariance"])


def test_quarter_turn_about_the_vertical(plain):
    """The entry-wise l1 norms of Eq. 7 allow signed permutations of the axes and no other rotation."""
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    turned = settled(HIT @ turn.T)
    np.testing.assert_allclose(turned.positions @ turn, plain.positions, atol=TOLERANCE["equivariance"])


def test_any_turn_where_the_model_has_no_entrywise_norm_of_the_motion():
    """With outliers priced out, low rank and isometry see a rotation of the whole clip as none."""
    angle = 0.7
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    clean = TRUTH - np.median(TRUTH.reshape(-1, 3), 0)
    kwargs = {"preset": "isometry_li2017", "outlier_weight": 1e3, "reach": 1e3}
    a, b = settled(clean, **kwargs), settled(clean @ turn.T, **kwargs)
    np.testing.assert_allclose(b.positions @ turn, a.positions, atol=1e-5)


def test_unit_change_with_rescaled_parameters(plain):
    """In millimetres: gamma in 1 / length^3, penalties in 1 / length, everything else without unit."""
    with pytest.warns(UserWarning, match="in metres"):
        changed = settled(
            HIT * 1000,
            lengths=LENGTHS * 1000,
            isometry_weight=100.0 / 1000**3,
            reach=0.02 * 1000,
            isometry_penalty_max=10.0 / 1000,
        )
    np.testing.assert_allclose(changed.positions / 1000, plain.positions, atol=TOLERANCE["equivariance"])


def test_joint_relabelling(plain):
    order = np.random.default_rng(0).permutation(25)
    place = np.argsort(order)
    edges = [(int(place[i]), int(place[j])) for i, j in SKELETON.edges]
    relabelled = settled(HIT[:, order], Skeleton([SKELETON.names[j] for j in order], edges))
    np.testing.assert_allclose(relabelled.positions[:, place], plain.positions, atol=TOLERANCE["equivariance"])


def test_bone_lengths_are_estimated_under_corruption():
    found = published(HIT, SKELETON)
    np.testing.assert_allclose(found.bone_lengths, LENGTHS, rtol=1e-6)


def test_missing_samples_are_filled_and_named():
    data = HIT.copy()
    data[10, 3] = np.nan
    observed = np.ones((FRAMES, 25), bool)
    observed[30:33, 12] = False
    found = published(data, SKELETON, observed=observed, bone_lengths=LENGTHS)
    expected = observed.copy()
    expected[10, 3] = False
    np.testing.assert_array_equal(found.observed, expected)
    assert np.isfinite(found.positions).all()
    assert (found.weights[~expected] == 0).all()
    assert (found.outliers[~expected] == 0).all()
    assert np.linalg.norm(found.positions - TRUTH, axis=-1)[~expected].max() < 0.05


def test_missing_samples_never_drift_to_the_origin():
    """Ten frames with nothing at all, or 30 % of all samples missing: about as near as straight lines in time."""
    empty = TRUTH.copy()
    empty[30:40] = np.nan
    scattered = np.where(np.random.default_rng(0).random((FRAMES, 25, 1)) < 0.3, np.nan, TRUTH)
    for data in (empty, scattered):
        missing = np.isnan(data[..., 0])
        found = published(data, SKELETON, bone_lengths=LENGTHS).positions
        line, error = (np.linalg.norm(x - TRUTH, axis=-1)[missing].mean() for x in (fill(data), found))
        assert error < 1.1 * line + 2e-3


def test_confidence_scales_trust():
    """A thrown sample that is declared worthless moves the answer less."""
    data, thrown = TRUTH.copy(), (20, 8)
    data[thrown] += 0.2
    confidence = np.ones((FRAMES, 25))
    confidence[thrown] = 0.0
    error = [
        np.linalg.norm(published(data, SKELETON, bone_lengths=LENGTHS, confidence=c).positions[thrown] - TRUTH[thrown])
        for c in (None, confidence)
    ]
    assert error[1] < error[0]


def test_zero_length_bones_are_merged_and_restored():
    """A joint doubled by a bone of no length comes back on the joint it doubles."""
    names = [*SKELETON.names, "double"]
    skeleton = Skeleton(names, [*SKELETON.edges, (4, 25)])
    doubled = np.concatenate([TRUTH, TRUTH[:, 4:5]], 1)
    data = hit(doubled, 0.05)
    found = published(data, skeleton)
    assert found.bone_lengths[-1] == 0
    np.testing.assert_array_equal(found.positions[:, 25], found.positions[:, 4])
    assert metrics.aje(found.positions, doubled) < 0.25 * metrics.aje(data, doubled)
    np.testing.assert_allclose(found.positions + found.outliers, data, atol=5e-3)


@pytest.mark.parametrize("name", GRAPHS)
def test_general_graphs(name):
    skeleton = GRAPHS[name]
    truth = clip(skeleton, 40)
    data = hit(truth, 0.05)
    found = published(data, skeleton, bone_lengths=lengths_of(skeleton, truth))
    assert metrics.aje(found.positions, truth) < metrics.aje(data, truth)
    assert np.nanmax(found.trace.inner_steps) > 0


def test_clean_synthetic_motion_keeps_its_shape():
    motion = synthesize(seconds=1.0)
    found = published(motion.positions, motion.skeleton)
    assert metrics.aje(found.positions, motion.positions) < 2e-3


def test_a_still_body_stays_still():
    still = np.repeat(TRUTH[:1], 16, 0)
    np.testing.assert_allclose(published(still, SKELETON).positions, still, atol=2e-3)


def test_float64_and_seconds():
    first = published(HIT, SKELETON, dtype=np.float64, max_steps=7)
    again = published(HIT, SKELETON, dtype=np.float64, max_steps=7)
    assert again.positions.dtype == np.float64
    assert first.seconds["compile"] > 0 == again.seconds["compile"]
    assert first.steps == 7
    assert "raise max_steps" in first.message


def test_verbose_prints_the_trace(capsys):
    published(HIT, SKELETON, max_steps=7, dtype=np.float64, verbose=True)
    printed = capsys.readouterr().out
    assert "primal" in printed
    assert "7" in printed


def test_nothing_observed_is_a_verdict():
    nothing = np.full((16, 25, 3), np.nan)
    for lengths in (LENGTHS, None):
        with pytest.raises(RecoveryError, match="No sample is observed"):
            published(nothing, SKELETON, bone_lengths=lengths)
    found = published(nothing, SKELETON, bone_lengths=LENGTHS, throw=False)
    assert np.isnan(found.positions).all()
    assert "No sample is observed" in found.message


def missing_joint():
    data = TRUTH.copy()
    data[:, 7] = np.nan
    return data


def infinite():
    data = TRUTH.copy()
    data[5, 3, 1] = np.inf
    return data


LOOSE = Skeleton(SKELETON.names, SKELETON.edges[:-1])
BAD = {
    "flat": (TRUTH[:, :, 0], {}, "shape (64, 25)"),
    "other joints": (TRUTH[:, :24], {}, "25 joints"),
    "empty": (TRUTH[:0], {}, "0 frames"),
    "one frame": (TRUTH[:1], {"bone_lengths": LENGTHS}, "1 frame:"),
    "five frames without lengths": (TRUTH[:5], {}, "fewer than 6"),
    "text": (np.array([["a"]]), {}, "real numbers"),
    "infinite": (infinite(), {}, "frame 5, joint 'ltibia'"),
    "joint never observed": (missing_joint(), {}, SKELETON.names[7]),
    "one point": (np.zeros((8, 25, 3)), {}, "coincide"),
    "no bones": (TRUTH, {"skeleton": Skeleton(SKELETON.names)}, "without bones"),
    "one joint": (TRUTH[:, :1], {"skeleton": Skeleton(["head"])}, "without bones"),
    "two parts": (TRUTH, {"skeleton": LOOSE}, "2 parts"),
    "unknown preset": (TRUTH, {"preset": "magic"}, "lowrank_wang2016"),
    "unknown initialisation": (TRUTH, {"preset": replace(PRESETS["str_yang2020"], initialisation="x")}, "'printed'"),
    "observed": (TRUTH, {"observed": np.ones((3, 25), bool)}, "observed of shape (3, 25)"),
    "confidence shape": (TRUTH, {"confidence": np.ones(25)}, "confidence of shape (25,)"),
    "confidence range": (TRUTH, {"confidence": np.full((FRAMES, 25), 2.0)}, "confidence of 2.0"),
    "negative length": (TRUTH, {"bone_lengths": -LENGTHS}, "lengths are positive"),
    "zero length": (TRUTH, {"bone_lengths": 0 * LENGTHS}, "root-lhipjoint"),
    "nan length": (TRUTH, {"bone_lengths": np.nan * LENGTHS}, "nan"),
    "lengths shape": (TRUTH, {"bone_lengths": [1.0]}, "24 bones"),
    "fps": (TRUTH, {"fps": 0}, "frame rate of 0"),
    "steps": (TRUTH, {"max_steps": 0}, "max_steps 0"),
    "dtype": (TRUTH, {"dtype": "float16"}, "float16"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_sentence(case, refused):
    data, arguments, words = BAD[case]
    arguments = {"skeleton": SKELETON, "preset": "str_yang2020", **arguments}
    refused(lambda: recover(data, **arguments), words, error=ValueError)
