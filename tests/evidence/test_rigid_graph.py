"""Bones of marker clouds: what is rigid is found, what is not gets none, and the answer is equivariant."""

import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover.evidence.rigid_graph import NEIGHBOURS, infer_graph
from motionrecover.skeleton import components

FRAMES, SIZE, CLUSTERS = 200, 6, 3
SEGMENT = np.repeat(np.arange(CLUSTERS), SIZE)


def segments(noise=0.002, seed=0):
    """Three segments (frame, marker, 3) of six markers that turn and travel on their own, with noise on the skin."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, FRAMES)[:, None]
    parts = []
    for _ in range(CLUSTERS):
        x, y, z = rng.uniform(-0.1, 0.1, (SIZE, 3)).T
        angle = rng.uniform(2, 5) * t
        turned = [np.cos(angle) * x + np.sin(angle) * z, y + 0 * angle, np.cos(angle) * z - np.sin(angle) * x]
        path = rng.normal(size=3) + np.sin(2 * np.pi * t * rng.uniform(1, 2, 3) + rng.uniform(0, 6, 3))
        parts.append(np.stack(turned, -1) + path[:, None])
    return np.concatenate(parts, 1) + noise * rng.normal(size=(FRAMES, CLUSTERS * SIZE, 3))


TAKE = segments()


def check(graph):
    i, j = np.array(graph.edges).T
    assert (SEGMENT[i] == SEGMENT[j]).all()
    assert len(components(graph.edges, len(SEGMENT))) == CLUSTERS
    assert np.bincount(np.r_[i, j]).min() >= NEIGHBOURS


@pytest.mark.parametrize("noise", [0, 0.0005, 0.002])
def test_segments_become_rigid_and_stay_apart(noise):
    graph = infer_graph(segments(noise))
    check(graph)
    i, j = np.array(graph.edges).T
    np.testing.assert_allclose(graph.length, np.median(np.linalg.norm(TAKE[:, i] - TAKE[:, j], axis=-1), 0), atol=5e-3)
    np.testing.assert_allclose(graph.spread, np.sqrt(2) * noise, rtol=0.35, atol=1e-9)
    assert (graph.frames == FRAMES).all()


def test_outliers_and_gaps_change_nothing_that_matters():
    rng = np.random.default_rng(1)
    thrown = rng.random(TAKE.shape[:2]) < 0.08
    data = np.where(thrown[..., None], TAKE + rng.uniform(-0.5, 0.5, TAKE.shape), TAKE)
    data[40:90, 2] = np.nan
    observed = rng.random(TAKE.shape[:2]) > 0.1
    graph = infer_graph(data, observed)
    check(graph)
    seen = observed & np.isfinite(data[..., 0])
    assert graph.frames.tolist() == [(seen[:, i] & seen[:, j]).sum() for i, j in graph.edges]


def test_no_constant_distance_no_edge():
    t = np.linspace(0, 1, FRAMES)[:, None, None]
    rng = np.random.default_rng(2)
    loose = np.sin(2 * np.pi * t * rng.uniform(1, 3, (9, 3)) + rng.uniform(0, 6, (9, 3)))
    assert infer_graph(loose).edges == ()
    joined = infer_graph(np.concatenate([TAKE, loose[:, :1]], 1))
    assert len(SEGMENT) not in np.ravel(joined.edges)
    assert joined.edges == infer_graph(TAKE).edges


def test_what_is_hardly_seen_together_is_no_edge():
    data = TAKE.copy()
    data[30:, 0] = np.nan
    data[:, 7] = np.nan
    assert not {0, 7} & set(np.ravel(infer_graph(data).edges).tolist())
    assert infer_graph(TAKE[:3]).edges == ()
    assert infer_graph(np.zeros((0, 4, 3))).edges == ()


def test_turned_moved_scaled_and_slowed_takes_have_the_same_edges():
    graph = infer_graph(TAKE)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    found = infer_graph(1000 * TAKE @ turn + 50)
    assert found.edges == graph.edges
    np.testing.assert_allclose(found.spread, 1000 * graph.spread, rtol=TOLERANCE["equivariance"])
    assert infer_graph(np.repeat(TAKE, 2, 0)).edges == graph.edges


def test_order_of_markers_means_nothing():
    order = np.random.default_rng(4).permutation(len(SEGMENT))
    found = infer_graph(TAKE[:, order])
    back = {frozenset(order[list(edge)].tolist()) for edge in found.edges}
    assert back == set(map(frozenset, infer_graph(TAKE).edges))


def test_misshapen_arrays_are_refused():
    with pytest.raises(ValueError, match="received positions of shape"):
        infer_graph(TAKE[0])
    with pytest.raises(ValueError, match="received observed of shape"):
        infer_graph(TAKE, np.ones((2, 2), bool))
