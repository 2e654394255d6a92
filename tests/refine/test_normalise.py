"""The way to the numbers a network sees, and back."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from helpers import TOLERANCE

from motionrecover import synthesize
from motionrecover.refine.normalise import CHOI, LI, Normaliser, place
from motionrecover.refine.sampling import resample, spans

MOTION = synthesize(2.0, seed=1)
SKELETON, ROOT = MOTION.skeleton, MOTION.skeleton.parents.index(-1)
POSITIONS = resample(MOTION.positions, MOTION.fps, 60.0)
SEEN = np.ones(len(SKELETON.names), bool)


def turned(positions, angle, shift):
    cos, sin = np.cos(angle), np.sin(angle)
    return positions @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]) + shift


def test_there_and_back():
    for convention in (CHOI, LI):
        placed = place(POSITIONS, SEEN, SKELETON, convention, 60.0)
        about = placed.inward(POSITIONS)
        np.testing.assert_allclose(placed.outward(about), POSITIONS, atol=TOLERANCE["svd"])
        normaliser = Normaliser.of([about[:50], about[50:]], convention.scale)
        np.testing.assert_allclose(normaliser.outward(normaliser.inward(about)), about, atol=TOLERANCE["network"])


def test_place_and_heading_make_no_difference():
    about = place(POSITIONS, SEEN, SKELETON, CHOI, 60.0).inward(POSITIONS)
    moved = turned(POSITIONS, 2.5, [3.0, -1.0, 40.0])
    np.testing.assert_allclose(
        place(moved, SEEN, SKELETON, CHOI, 60.0).inward(moved), about, atol=TOLERANCE["equivariance"]
    )
    moved = turned(POSITIONS, 0.0, [3.0, -1.0, 40.0])
    about = place(POSITIONS, SEEN, SKELETON, LI, 60.0).inward(POSITIONS)
    np.testing.assert_allclose(
        place(moved, SEEN, SKELETON, LI, 60.0).inward(moved), about, atol=TOLERANCE["equivariance"]
    )


def test_the_body_faces_z_and_stands_at_the_origin():
    about = place(POSITIONS, SEEN, SKELETON, CHOI, 60.0).inward(POSITIONS)
    left, right = SKELETON.mirror[0]
    across = (about[:, left] - about[:, right]).mean(0)
    assert across[0] > 5 * abs(across[2])
    assert (about[:, ROOT] == 0).all()
    on_ground = place(POSITIONS, SEEN, SKELETON, LI, 60.0).inward(POSITIONS)
    assert abs(np.quantile(on_ground[..., 1], 0.01)) < 1e-6
    assert (on_ground[:, ROOT, [0, 2]] == 0).all()


def test_a_root_never_seen_is_where_the_mean_pose_fits():
    mean = place(POSITIONS, SEEN, SKELETON, CHOI, 60.0).inward(POSITIONS).mean(0)
    seen = SEEN.copy()
    seen[ROOT] = False
    without = np.where(seen[:, None], POSITIONS, 0.0)
    found = place(without, seen, SKELETON, CHOI, 60.0, mean).origin
    assert np.linalg.norm(found - POSITIONS[:, ROOT], axis=-1).mean() < 0.15
    kept = replace(CHOI, heading="kept")
    assert (place(POSITIONS, SEEN, SKELETON, kept, 60.0).heading == 0).all()


def test_normalised_motion_has_mean_zero_and_the_scale_asked_for():
    about = place(POSITIONS, SEEN, SKELETON, CHOI, 60.0).inward(POSITIONS)
    clips = [about[:40], about[40:]]
    values = Normaliser.of(clips, "axes").inward(about)
    np.testing.assert_allclose(values.mean(0), 0, atol=TOLERANCE["network"])
    np.testing.assert_allclose(np.abs(values).max((0, 1)), 1, atol=TOLERANCE["network"])
    np.testing.assert_allclose(Normaliser.of(clips, "overall").inward(about).std(), 1, rtol=1e-5)


def test_resampling_keeps_lines_and_picks_frames():
    t = np.arange(13.0)[:, None, None] * np.ones((13, 2, 3))
    np.testing.assert_array_equal(resample(t, 120, 60), t[::2])
    np.testing.assert_allclose(resample(t, 30, 60), np.arange(25.0)[:, None, None] / 2 * np.ones((25, 2, 3)))
    np.testing.assert_allclose(resample(resample(t, 30, 100), 100, 30, 13), t, atol=TOLERANCE["network"])
    assert len(resample(t, 60, 60, 15)) == 15


def test_windows_cover_the_clip_with_overlaps_of_half_or_more():
    for frames in (1, 64, 65, 96, 97, 500):
        cuts = spans(frames, 64)
        assert {cut.stop - cut.start for cut in cuts} == {64}
        assert cuts[0].start == 0
        assert cuts[-1].stop == max(frames, 64)
        assert all(b.start - a.start <= 32 for a, b in pairwise(cuts))
