"""Peers that see the whole body: principal components, soft-impute and robust principal components.

All of them work on coordinates relative to the body: global coordinates are fatal for a low rank.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tensorly.decomposition import robust_pca

from benchmarks.suite.peers_time import SHORT_GAP, cubic, despike, nothing, running_median


def pca(positions: np.ndarray, fps: float) -> np.ndarray:
    """Gaps filled by the correlation between joints: strategy R2 of Gloersen & Federolf.

    "Predicting missing marker trajectories in human motion data using marker intercorrelations", PLoS ONE 11(3), 2016,
    e0152616; Federolf, PLoS ONE 8(10), 2013, Eq. 1. Settings as published: sigma = 200 mm, weight of the missing joint
    0.02, distal threshold 0.5, 99 % of the singular values. Per joint j with gaps, on positions relative to the mean
    of the joints without gaps:

    1. joints that have gaps and are farther from j than half the mean distance, or whose gaps overlap those of j, are
       left out;
    2. N: the frames in which every joint left is seen; N_z: the same with j zeroed; both scaled to unit variance and
       weighted by exp(-distance^2 / 2 sigma^2);
    3. with V, V_z the leading principal directions of N and N_z, the gap is M_z V_z (V_z^T V) V^T, scaled back.

    Step 3 maps the scores of the incomplete directions to those of the complete ones. Spikes are set missing and gaps
    up to 0.1 s are filled by a spline before, as its users do.
    """
    known = cubic(despike(positions), SHORT_GAP * fps)
    missing = np.any(np.isnan(known), axis=-1)
    gapped = missing.any(0)
    origin = _middle(known)
    local, out = known - origin, known.copy()
    for joint in np.flatnonzero(gapped & ~missing.all(0)):
        lost = missing[:, joint]
        distances = np.nanmean(np.linalg.norm(local - local[:, [joint]], axis=-1), 0)
        far = gapped & (distances > 0.5 * np.nanmean(distances))
        overlapping = missing[lost].any(0)
        left = ~(far | overlapping)
        left[joint] = False
        frames = ~missing[:, left].any(1) & ~lost
        # Where every frame lacks some joint, only those without gaps are left.
        if frames.sum() < 10:
            left, frames = left & ~gapped, ~lost
        weights = np.append(np.exp(-(distances[left] ** 2) / (2 * 0.2**2)), 0.02).repeat(3)
        columns = np.append(np.flatnonzero(left), joint)
        filled = _from_components(local[:, columns].reshape(len(local), -1), frames, lost, weights)
        out[lost, joint] = filled + origin[lost, 0]
    return nothing(out, fps)


def soft_impute(positions: np.ndarray, fps: float) -> np.ndarray:
    """Missing samples from the matrix of least nuclear norm through the samples left.

    Mazumder, Hastie & Tibshirani, "Spectral regularization algorithms for learning large incomplete matrices", JMLR 11,
    2010, Algorithm 1: Z <- S_lambda(P_observed(X) + P_missing(Z)) along a falling path of lambda with warm starts, S
    the singular value threshold, with Nesterov's steps between (Yao & Kwok, IJCAI 2015). Where `fancyimpute` has it, it
    calls an interface that scikit-learn has dropped. The path ends at a thousandth of the largest singular value, and
    the matrix is (3 frame, joint) with its means left in: on gaps its error is a tenth of that of (frame, 3 joint)
    with means taken off. Spikes are set missing and gaps up to 0.1 s are filled by a spline before, as in `pca`.
    """
    known = cubic(despike(positions), SHORT_GAP * fps)
    origin = _middle(known)
    matrix = _stacked(known - origin)
    missing = np.isnan(matrix)
    if not missing.any() or missing.all(0).any():
        return known
    fit = np.zeros(matrix.shape)
    for threshold in np.linalg.norm(np.where(missing, 0, matrix), 2) * 0.5 ** np.arange(1, 11):
        fit = _shrunk(matrix, missing, fit, threshold)
    return _unstacked(np.where(missing, fit, matrix), len(known)) + origin


def rpca_poses(positions: np.ndarray, fps: float) -> np.ndarray:
    """Robust principal components of the matrix (frame, 3 joint), lambda = 2 / sqrt(n): the better one on spikes."""
    return _rpca(
        positions, fps, 2.0, lambda local: local.reshape(len(local), -1), lambda low: low.reshape(len(low), -1, 3)
    )


def rpca_motion(positions: np.ndarray, fps: float) -> np.ndarray:
    """Robust principal components of the matrix (3 frame, joint), lambda = 3 / sqrt(n): the better one on gaps."""
    return _rpca(positions, fps, 3.0, _stacked, lambda low: _unstacked(low, len(positions)))


def _rpca(positions: np.ndarray, fps: float, weight: float, matrix_of: Callable, positions_of: Callable) -> np.ndarray:
    """Robust principal components with missing entries, by `tensorly.decomposition.robust_pca`.

    Candes, Li, Ma & Wright, "Robust principal component analysis?", J. ACM 58(3), 2011: min |L|_* + lambda |S|_1 with
    L + S = D on the observed entries, by an augmented Lagrangian. tensorly sums the nuclear norms of all unfoldings, of
    which a matrix has two, so its `reg_E` is 2 lambda. First penalty 1.25 / |D|_2 (Lin, Chen & Ma, arXiv:1009.5055,
    Sec. 4.2). Their lambda = 1 / sqrt(n), n the longer side, moves clean clips by 6 mm and more; the weights here are
    the best over spikes and gaps of 0.7, 1, 1.5, 2, 3, 4. Spikes that a filter in time can see are set missing before,
    and gaps up to 0.1 s are filled by a spline.
    """
    despiked = despike(positions)
    known = np.where(np.isnan(positions), cubic(despiked, SHORT_GAP * fps), despiked)
    # Spikes that are left would shift a mean.
    origin = running_median(_middle(known), 5)
    matrix = matrix_of(nothing(known - origin, 0))
    low = robust_pca(
        matrix,
        mask=np.isfinite(matrix_of(known)),
        tol=1e-6,
        reg_E=2 * weight / np.sqrt(max(matrix.shape)),
        mu_init=1.25 / float(np.linalg.norm(matrix, 2)),
        n_iter_max=150,
        verbose=0,
    )[0]
    return positions_of(np.asarray(low)) + origin


def _middle(positions: np.ndarray) -> np.ndarray:
    """Where the body is (frame, 1, 3): the mean of the joints without gaps, of all once linearly filled where fewer
    than three have none. The root alone is worse by a tenth, and much worse where it is missing itself."""
    whole = np.isfinite(positions).all((0, 2))
    return (positions[:, whole] if whole.sum() > 2 else nothing(positions, 0)).mean(1, keepdims=True)


def _from_components(matrix: np.ndarray, frames: np.ndarray, lost: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The last three columns in the frames `lost`, told from the others by the frames `frames`: step 3 of `pca`."""
    whole = matrix[frames]
    mean, scale = whole.mean(0), whole.std(0)
    scale = np.where(scale > 0, scale, 1) / weights
    whole = (whole - mean) / scale
    zeroed = np.concatenate([whole[:, :-3], np.zeros_like(whole[:, -3:])], 1)
    incomplete = ((matrix - mean) / scale)[lost, :-3]
    (full, full_share), (partial, partial_share) = (_directions(part) for part in (whole, zeroed))
    count = max(full_share, partial_share)
    full, partial = full[:, :count], partial[:, :count]
    scores = incomplete @ partial[:-3]
    return (scores @ (partial.T @ full) @ full.T * scale + mean)[:, -3:]


def _directions(matrix: np.ndarray) -> tuple[np.ndarray, int]:
    """Principal directions (column, component), and how many hold 99 % of the sum of the singular values."""
    _, singular, directions = np.linalg.svd(matrix, full_matrices=False)
    return directions.T, int(np.searchsorted(np.cumsum(singular), 0.99 * singular.sum()) + 1)


def _stacked(positions: np.ndarray) -> np.ndarray:
    """(3 frame, joint) of positions (frame, joint, 3)."""
    return positions.transpose(2, 0, 1).reshape(-1, positions.shape[1])


def _unstacked(matrix: np.ndarray, frames: int) -> np.ndarray:
    return matrix.reshape(3, frames, -1).transpose(1, 2, 0)


def _shrunk(data: np.ndarray, missing: np.ndarray, fit: np.ndarray, threshold: float) -> np.ndarray:
    """Soft-impute at one threshold, until the missing entries move by less than a ten thousandth."""
    before, speed = fit, 1.0
    for _ in range(150):
        faster = (1 + np.sqrt(1 + 4 * speed**2)) / 2
        filled = np.where(missing, fit + (speed - 1) / faster * (fit - before), data)
        # Singular vectors from the small Gram matrix: a fraction of the time of a singular value decomposition.
        squares, right = np.linalg.eigh(filled.T @ filled)
        singular = np.sqrt(np.maximum(squares, 1e-30))
        before, fit, speed = fit, filled @ (right * (np.maximum(singular - threshold, 0) / singular)) @ right.T, faster
        if np.linalg.norm((fit - before)[missing]) <= 1e-4 * np.linalg.norm(before[missing]):
            break
    return fit
