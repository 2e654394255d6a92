"""Other bodies: bones of other lengths, mirrored, backwards, turned, each by its definition."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import clip

from motionrecover.refine import augment
from motionrecover.skeleton import Skeleton

BODY = Skeleton.standard("cmu21")
CLEAN = np.stack([clip(BODY, 16, seed) for seed in range(24)])
"""(window, frame, joint, 3)."""


def drawn(seed=0):
    return np.asarray(augment.augmented(jax.random.key(seed), jnp.asarray(CLEAN), BODY))


def test_bones_keep_their_new_length_which_is_within_bounds_and_the_same_on_both_sides(monkeypatch):
    monkeypatch.setattr(augment, "TURN", 0.0)
    found, before = (np.stack([BODY.bone_lengths_of(x) for x in clips]) for clips in (drawn(), CLEAN))
    assert np.ptp(found, axis=1).max() < 1e-5
    parents = np.array(BODY.parents)
    bone_of = {child: k for k, edge in enumerate(BODY.edges) for child in edge if parents[child] in edge}
    sides = [(bone_of[a], bone_of[b]) for a, b in BODY.mirror]
    # A mirrored window has the left arm of the other side: as sets of two, ratios are those of the pair.
    for window, (old, new) in enumerate(zip(before[:, 0], found[:, 0], strict=True)):
        same, swapped = new / old, new.copy()
        for a, b in sides:
            swapped[[a, b]] = new[[b, a]]
        swapped /= old
        ratio = same if all(np.isclose(same[a], same[b], rtol=1e-4) for a, b in sides) else swapped
        np.testing.assert_allclose([ratio[a] for a, _ in sides], [ratio[b] for _, b in sides], rtol=1e-4)
        assert 1 / (1 + augment.SPREAD) - 1e-4 < ratio.min() < ratio.max() < 1 + augment.SPREAD + 1e-4, window
        assert np.ptp(ratio) > 0.1


def test_without_other_lengths_windows_are_mirrored_reversed_both_or_as_they_were(monkeypatch):
    monkeypatch.setattr(augment, "SPREAD", 0.0)
    monkeypatch.setattr(augment, "TURN", 0.0)
    swap = np.arange(21)
    for a, b in BODY.mirror:
        swap[[a, b]] = b, a
    kinds = set()
    for new, old in zip(drawn(), CLEAN, strict=True):
        mirrored = old[:, swap] * [-1, 1, 1]
        forms = {"same": old, "mirrored": mirrored, "backwards": old[::-1], "both": mirrored[::-1]}
        (kind,) = (name for name, form in forms.items() if np.allclose(new, form, atol=1e-5))
        kinds.add(kind)
    assert len(kinds) == 4


def test_a_turn_is_about_the_vertical(monkeypatch):
    monkeypatch.setattr(augment, "SPREAD", 0.0)
    found = drawn(1)
    heights = np.sort(found[..., 1].reshape(len(found), -1)), np.sort(CLEAN[..., 1].reshape(len(found), -1))
    np.testing.assert_allclose(*heights, atol=1e-5)
    np.testing.assert_allclose(drawn(1), found)
    assert np.abs(drawn(2) - found).max() > 0.01
