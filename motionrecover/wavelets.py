"""Orthogonal periodised wavelet transform along frames: W and W^T for every orthogonal family of PyWavelets.

One level splits a signal x of n frames, n even and periodic, into approximation and detail coefficients,

    lo[k] = sum_j h[j] x[2k + L/2 - j],    hi[k] = sum_j g[j] x[2k + L/2 - j],    k = 0 .. n/2 - 1,

with the decomposition filters h, g of L taps (Mallat, "A Wavelet Tour of Signal Processing", Ch. 7; alignment as
PyWavelets' mode `periodization`). Orthogonal filters make this an orthogonal matrix, and its transpose the inverse:
the condition W^T W = I that Yang et al. 2020 need below Eq. 13. The next level splits `lo` again.

Any length. A level with an odd number of samples transforms all but its last one and carries that one over as a
coefficient of its own, so W stays orthogonal at every length from 1 on, where PyWavelets repeats a sample and is not.

Padding. `frames` says how many of the stored frames are valid; it may be traced, so one compiled program serves every
length up to the stored one. Frames from `frames` on are ignored by `wavedec` and are zero in the answer of `waverec`:
W is the transform of the valid frames, whatever the padding.

Coefficients are packed along the last axis as [lo of the last level | hi of the last level | ... | hi of level 1];
slots that a short or odd level leaves free hold zeros.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int


@cache
def filters(wavelet: str) -> np.ndarray:
    """Decomposition filters (2, tap) of an orthogonal wavelet: low pass, high pass, in float64.

    Raises `ValueError` for an unknown or non-orthogonal wavelet.
    """
    import pywt  # for the filters alone

    known = pywt.wavelist(kind="discrete")  # pyright: ignore[reportAttributeAccessIssue]
    if wavelet not in known:
        raise ValueError(f"received wavelet {wavelet!r}: give one of {', '.join(known)}")
    bank = pywt.Wavelet(wavelet)  # pyright: ignore[reportAttributeAccessIssue]
    low = np.asarray(bank.dec_lo)
    shifts = range(0, len(low), 2)
    error = np.array([low[: len(low) - s] @ low[s:] for s in shifts]) - (np.arange(len(low) // 2) == 0)
    if not bank.orthogonal or abs(error).max() > 1e-8:  # dmey calls itself orthogonal and is off by 2e-3
        raise ValueError(
            f"received wavelet {wavelet!r}: its filters are not orthogonal, use a Daubechies, symlet or coiflet"
        )
    # PyWavelets tabulates some filters (sym3, sym20) to 1e-11 only: one Gauss-Newton step onto the conditions
    # sum_n h[n] h[n + 2k] = (k == 0) brings the error to rounding.
    jacobian = np.array([np.pad(low[s:], (0, s)) + np.pad(low[: len(low) - s], (s, 0)) for s in shifts])
    low = low - np.linalg.lstsq(jacobian, error, rcond=None)[0]
    high = low[::-1] * np.where(np.arange(len(low)) % 2, 1, -1)
    return np.stack([low, high])


def levels(frames: int, level: int) -> list[int]:
    """Stored lengths of `lo` and `hi` at level 1, 2, ... `level` for a stored length of `frames`."""
    sizes = [frames]
    for _ in range(level):
        sizes.append(-(-sizes[-1] // 2))
    return sizes[1:]


def wavedec(
    x: Float[Array, "*batch frame"], wavelet: str, level: int, frames: Int[Array, ""] | int | None = None
) -> Float[Array, "*batch coefficient"]:
    """W x along the last axis; `level` 0 is the identity."""
    valid = jnp.asarray(x.shape[-1] if frames is None else frames)
    lo, details = _keep(x, valid), []
    for _ in range(level):
        lo, hi = _split(lo, filters(wavelet), valid)
        details.append(hi)
        valid = valid // 2
    return jnp.concatenate([lo, *reversed(details)], -1)


def waverec(
    coefficients: Float[Array, "*batch coefficient"],
    length: int,
    wavelet: str,
    level: int,
    frames: Int[Array, ""] | int | None = None,
) -> Float[Array, "*batch frame"]:
    """W^T c along the last axis, for signals of a stored `length`: the adjoint and the inverse of `wavedec`."""
    valid = jnp.asarray(length if frames is None else frames)
    sizes = levels(length, level)
    lo, at = coefficients[..., : sizes[-1] if level else length], sizes[-1] if level else length
    for step in reversed(range(level)):
        hi = coefficients[..., at : at + sizes[step]]
        at += sizes[step]
        lo = _merge(lo, hi, filters(wavelet), valid // 2**step, (length, *sizes)[step])
    return _keep(lo, valid)


def _keep(x, valid):
    """Zero from `valid` on."""
    return jnp.where(jnp.arange(x.shape[-1]) < valid, x, 0)


def _extend(x, before, after, period):
    """`x`, valid and periodic over `period` samples, with `before` and `after` more samples at its valid ends."""
    period = jnp.maximum(period, 1)
    front = jnp.take(x, jnp.arange(-before, 0) % period, axis=-1)
    back = jnp.take(x, jnp.arange(after) % period, axis=-1)
    room = jnp.zeros((*x.shape[:-1], after), x.dtype)
    extended = jnp.concatenate([front, x, room], -1)
    return lax.dynamic_update_slice_in_dim(extended, back, before + period, -1)


def _correlate(phases, taps, size, period):
    """sum over phase p and shift q of taps[o, p, q] phases[p][k + q], periodic, for k < size; one result for each o."""
    shifts = sorted(q for _, q in taps)
    before, after = max(0, -shifts[0]), max(0, shifts[-1])
    extended = [_extend(phase, before, after, period) for phase in phases]
    outputs = []
    for o in range(2):
        terms = [float(tap[o]) * extended[p][..., before + q : before + q + size] for (p, q), tap in taps.items()]
        outputs.append(_keep(sum(terms[1:], terms[0]), period))
    return outputs


def _split(x, bank, valid):
    """One level of analysis of `x`, zero from `valid` on: (lo, hi), each half as long, rounded up."""
    size, half = -(-x.shape[-1] // 2), valid // 2
    phases = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, 2 * size - x.shape[-1])])
    phases = [phases[..., 0::2], phases[..., 1::2]]
    taps = bank.shape[1]
    offsets = {j: taps // 2 - j for j in range(taps)}
    lo, hi = _correlate(phases, {(i % 2, i // 2): bank[:, j] for j, i in offsets.items()}, size, half)
    odd = (jnp.arange(size) == half) & (valid % 2 == 1)
    return lo, jnp.where(odd, phases[0], hi)


def _merge(lo, hi, bank, valid, length):
    """One level of synthesis, the transpose of `_split`."""
    size, half = lo.shape[-1], valid // 2
    taps = bank.shape[1]
    # x[2t + r] = sum_d h[2d + L/2 - r] lo[t + d] + g[2d + L/2 - r] hi[t + d]
    terms = {}
    for d in range(-taps, taps + 1):
        at = [2 * d + taps // 2 - r for r in (0, 1)]
        if any(0 <= j < taps for j in at):
            for p in (0, 1):
                terms[p, d] = [bank[p, j] if 0 <= j < taps else 0.0 for j in at]
    even, odd = _correlate([lo, hi], terms, size, half)
    carried = (jnp.arange(size) == half) & (valid % 2 == 1)
    even = jnp.where(carried, hi, even)
    return jnp.stack([even, odd], -1).reshape(*lo.shape[:-1], 2 * size)[..., :length]
