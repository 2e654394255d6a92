"""Runs in masks against their definitions, frame by frame."""

from itertools import groupby

import numpy as np
import pytest

from motionrecover.runs import frames_away, run_lengths, runs_of


@pytest.fixture(params=[(0, 2), (1, 2), (2, 3), (40, 30)], ids=str)
def mask(request):
    """Columns from all False to all True."""
    frames, columns = request.param
    return np.random.default_rng(0).random((frames, columns)) < np.linspace(0, 1, columns)


def brute_force(column):
    """(value, start, stop) of the stretches of equal values."""
    stop = 0
    for value, stretch in groupby(column.tolist()):
        start, stop = stop, stop + len(list(stretch))
        yield value, start, stop


def test_runs_are_the_stretches_of_true(mask):
    for column in mask.T:
        assert runs_of(column) == [(start, stop) for value, start, stop in brute_force(column) if value]


def test_run_lengths_are_those_of_the_runs(mask):
    expected = np.zeros(mask.shape, int)
    for joint, column in enumerate(mask.T):
        for value, start, stop in brute_force(column):
            expected[start:stop, joint] = value * (stop - start)
    np.testing.assert_array_equal(run_lengths(mask), expected)


def test_frames_away_is_the_least_distance(mask):
    away = frames_away(mask)
    assert away.shape == mask.shape
    for (frame, joint), found in np.ndenumerate(away):
        assert found == np.abs(np.flatnonzero(mask[:, joint]) - float(frame)).min(initial=np.inf)
