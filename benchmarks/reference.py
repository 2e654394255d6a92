"""Algorithm 1 of Yang et al. 2020 in plain NumPy and SciPy: oracle of the tests, yardstick of the benchmarks.

Written from the paper, on the 3T x S matrix, with what a reader would reach for: `numpy.linalg.svd`, `pywt` along each
column, a sparse Jacobian and `scipy.sparse.linalg.cg`. It shares no code with the package. The number of frames must
be divisible by 2^J, where PyWavelets' periodised transform is orthogonal.
"""

import numpy as np
import pywt
import scipy.sparse as sp
from scipy.sparse.linalg import cg


def soft(x, threshold):
    """S_delta below Eq. 11."""
    return np.sign(x) * np.maximum(np.abs(x) - threshold, 0)


def wavedec(matrix, wavelet, level):
    """W along time of each coordinate of each joint, with the coefficients in the place of the frames."""
    frames = matrix.reshape(-1, 3, matrix.shape[1])
    coefficients = pywt.wavedec(frames, wavelet, mode="periodization", level=level, axis=0)
    return np.concatenate(coefficients).reshape(matrix.shape)


def waverec(coefficients, wavelet, level):
    """W^T."""
    frames = coefficients.reshape(-1, 3, coefficients.shape[1])
    sizes = [len(frames) >> level] + [len(frames) >> j for j in range(level, 0, -1)]
    parts = np.split(frames, np.cumsum(sizes)[:-1])
    return pywt.waverec(parts, wavelet, mode="periodization", axis=0).reshape(coefficients.shape)


def linearise(matrix, edges, lengths):
    """F (Eq. 5, 16) and its sparse Jacobian with respect to the matrix in row-major order."""
    (rows, joints), bones = matrix.shape, len(edges)
    frames = rows // 3
    i, j = np.asarray(edges).T
    positions = matrix.reshape(frames, 3, joints)
    d = positions[:, :, i] - positions[:, :, j]
    f = (d**2).sum(1) - np.asarray(lengths) ** 2
    t, c, h = np.meshgrid(np.arange(frames), np.arange(3), np.arange(bones), indexing="ij")
    row, column = t * bones + h, (3 * t + c) * joints
    entries = np.concatenate([2 * d.ravel(), -2 * d.ravel()])
    at = np.tile(row.ravel(), 2), np.concatenate([(column + i[h]).ravel(), (column + j[h]).ravel()])
    return f.ravel(), sp.csr_matrix((entries, at), shape=(frames * bones, rows * joints))


def algorithm1(
    D, edges, lengths, lam, gamma, mu, rho, eta, rho_max, steps, A0=None, wavelet="db10", level=2, rtol=1e-6
):
    """Lines 2-19 of Algorithm 1. `rho`, `rho_max`: three penalties; `A0`: the start of A, D if left out.

    Returns A, E, and the objective of Eq. 8 after every step.
    """
    A = D.copy() if A0 is None else A0.copy()
    N = D.copy()
    Z1, Z2, Z3 = np.zeros_like(D), np.zeros_like(D), np.zeros_like(D)
    rho, rho_max = np.array(rho, D.dtype), np.array(rho_max, D.dtype)
    identity = sp.identity(D.size, dtype=D.dtype, format="csr")
    energy = []
    for _ in range(steps):
        F, J = linearise(N, edges, lengths)
        system = gamma * (J.T @ J) + rho[1] * identity
        right = (-Z2 - rho[1] * (N - A)).ravel() - gamma * (J.T @ F)
        delta, _ = cg(system, right, rtol=rtol, M=sp.diags(1 / system.diagonal()))
        N = N + delta.reshape(D.shape)
        WA = wavedec(A, wavelet, level)
        C = soft(WA - Z3 / rho[2], mu / rho[2])
        E = soft(D - A - Z1 / rho[0], lam / rho[0])
        H1, H2, H3 = D - E - Z1 / rho[0], N + Z2 / rho[1], waverec(C + Z3 / rho[2], wavelet, level)
        U, s, Vt = np.linalg.svd((rho[0] * H1 + rho[1] * H2 + rho[2] * H3) / rho.sum(), full_matrices=False)
        s = np.maximum(s - 1 / rho.sum(), 0)
        A = (U * s) @ Vt
        Z1 = Z1 + rho[0] * (E - D + A)
        Z2 = Z2 + rho[1] * (N - A)
        Z3 = Z3 + rho[2] * (C - wavedec(A, wavelet, level))
        rho = np.minimum(eta * rho, rho_max)
        F, _ = linearise(N, edges, lengths)
        energy.append(s.sum() + lam * np.abs(E).sum() + gamma / 2 * (F @ F) + mu * np.abs(C).sum())
    return A, E, np.array(energy)
