"""The tables of the learned papers: the page is of the results, rows and measures are what they say."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import clip

from benchmarks.studies import learned, learned_report
from benchmarks.studies.learned_tables import NETWORKS, ROWS, SUFFIXES, TABLES
from benchmarks.suite.clips import Clip
from motionrecover.refine import losses, models
from motionrecover.skeleton import Skeleton

BODY = Skeleton.standard("cmu21")
WALK = Clip("99_01", clip(BODY, 80), BODY, 60.0)


def test_the_page_is_what_the_results_say():
    text, results = learned_report.PAGE.read_text(), json.loads(learned.RESULTS.read_text())
    assert learned_report.render(results, text) == text
    with pytest.raises(KeyError, match="nonsense"):
        learned_report.render(results, "<!-- learned: nonsense -->\n<!-- learned end -->")


def test_tables_name_rows_and_networks_that_there_are():
    for table in TABLES.values():
        assert set(table.rows) <= ROWS.keys()
        assert set(table.networks) <= NETWORKS.keys()
        for row, found in (table.printed or {}).items():
            assert row in (*table.rows, "mean")
            assert set(found) <= {*table.networks, *table.beside}
            assert all(len(numbers) == len(table.measures) for numbers in found.values())
    assert {network.model for network in NETWORKS.values()} <= models.MODELS.keys()


@pytest.mark.parametrize("name", ROWS)
def test_a_row_does_what_it_says_and_the_same_for_a_seed(name):
    row = ROWS[name]
    data = row.corrupted(WALK, 0)
    np.testing.assert_array_equal(data, row.corrupted(WALK, 0))
    others = (row.corrupted(WALK, seed) for seed in range(1, 5))
    assert any((np.isnan(data) != np.isnan(other)).any() for other in others) or not (row.missing or row.joints)
    missing = np.isnan(data[..., 0])
    assert missing.all(0).sum() == row.joints
    assert missing.mean() == pytest.approx(row.missing + row.joints / 21, abs=0.03)
    off = (data - WALK.positions)[~missing]
    if row.sigma and not row.sensor:
        assert off.std() == pytest.approx(row.sigma, rel=0.1)
    if row.displaced:
        assert (off != 0).any(-1).mean() == pytest.approx(row.displaced, abs=0.03)
    if not row.noisy:
        assert (off == 0).all()


def test_decibels_are_those_of_the_motion_about_its_mean_pose():
    loud, faint = (np.std(ROWS[f"noise of {d} dB"].corrupted(WALK, 0) - WALK.positions) for d in (1, 20))
    assert loud / faint == pytest.approx(10 ** (19 / 20), rel=0.05)


def test_measures_are_zero_at_the_truth_and_by_their_equations():
    data = ROWS["10 % missing"].corrupted(WALK, 0)
    assert learned.score(WALK.positions, data, WALK)[:5] == [0] * 5
    moved = dict(
        zip(learned.MEASURES, learned.score(WALK.positions + np.array([0.03, 0, 0.04]), data, WALK), strict=True)
    )
    assert moved["P"] == pytest.approx(5)
    assert moved["missing"] == pytest.approx(5)
    assert moved["R"] == pytest.approx(7 / 3)
    assert moved["B"] == pytest.approx(0, abs=1e-9)
    first = WALK.positions[:64] - WALK.positions[:64, :1]
    assert learned.roughness(first)[0] == pytest.approx(float(losses.smooth(first[None])), rel=1e-5)


def test_the_mean_pose_keeps_what_was_observed():
    data = ROWS["2 joints throughout"].corrupted(WALK, 0)
    found = learned.Baselines(np.zeros((21, 3))).mean_pose(data, WALK)
    seen = ~np.isnan(data)
    assert (found[seen] == data[seen]).all()
    np.testing.assert_allclose(found[~seen].reshape(80, -1, 3), np.repeat(WALK.positions[:, :1], 2, axis=1), atol=1e-9)


def test_a_network_is_compared_in_each_way_that_its_row_allows():
    row, table = ROWS["40 % missing"], TABLES["choi2"]
    networks = dict.fromkeys(table.networks)
    found = learned.methods_of(row, networks, np.zeros((21, 3)))
    assert {"bra-dgn" + suffix for suffix in SUFFIXES} <= found.keys()
    noisy = learned.methods_of(replace(row, sigma=0.01), networks, np.zeros((21, 3)))
    assert not [name for name in noisy if name.endswith(", kept")]
