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

from motionrecover.kernel import one_kernel


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
    lo, details = x if level else _keep(x, valid), []
    for _ in range(level):
        lo, hi = _split(lo, wavelet, valid)
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
        lo = _merge(lo, hi, wavelet, valid // 2**step, (length, *sizes)[step])
    return lo if level else _keep(lo, valid)


def _keep(x, valid):
    """Zero from `valid` on."""
    return jnp.where(jnp.arange(x.shape[-1]) < valid, x, 0)


def _correlate(phases, taps, before, valid, carry):
    """sum over phase p and q of taps[o, p, q] phases[p][k + q - before], of period `valid` // 2, for both outputs o.

    What an odd level carries over goes from one phase to one output, `carry`; the padding is 0.

    Apart from what reads them: merged with it, they take 3 times as long.
    """
    size, after, period = phases.shape[-1], taps.shape[-1] - 1 - before, jnp.maximum(valid // 2, 1)
    front = jnp.take(phases, jnp.arange(-before, 0) % period, axis=-1)
    back = jnp.take(phases, jnp.arange(after) % period, axis=-1)
    room = jnp.zeros((*phases.shape[:-1], after), phases.dtype)
    extended = jnp.concatenate([front, phases, room], -1)
    extended = lax.dynamic_update_slice_in_dim(extended, back, before + period, -1)
    at = jnp.arange(size)

    def output(o, phases, extended, valid):
        used = [(p, q) for p in range(2) for q in range(taps.shape[-1]) if taps[:, p, q].any()]
        tap = jnp.asarray(taps[o], phases.dtype)
        terms = [tap[p, q] * extended[p, ..., q : q + size] for p, q in used]
        rest = jnp.where((at == valid // 2) & (valid % 2 == 1), phases[carry[0]], 0) if o == carry[1] else 0
        return jnp.where(at < valid // 2, sum(terms[1:], terms[0]), rest)

    return one_kernel(lambda *x: (output(0, *x), output(1, *x)))(phases, extended, valid)


@cache
def _analysis(wavelet: str) -> tuple[np.ndarray, int]:
    """Taps (output, phase, shift) from the even and odd samples to lo and hi, and how many shifts are negative."""
    bank = filters(wavelet)
    offsets = bank.shape[1] // 2 - np.arange(bank.shape[1])
    shifts = offsets // 2
    taps = np.zeros((2, 2, np.ptp(shifts) + 1))
    taps[:, offsets % 2, shifts - shifts.min()] = bank
    return taps, -shifts.min()


@cache
def _synthesis(wavelet: str) -> tuple[np.ndarray, int]:
    """The transpose of `_analysis`: taps from lo and hi to the even and odd samples."""
    taps, before = _analysis(wavelet)
    return taps.transpose(1, 0, 2)[..., ::-1], taps.shape[-1] - 1 - before


def _split(x, wavelet, valid):
    """One level of analysis of `x`, valid up to `valid`: (lo, hi), each half as long, rounded up."""
    size = -(-x.shape[-1] // 2)
    x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, 2 * size - x.shape[-1])])
    return _correlate(jnp.stack([x[..., 0::2], x[..., 1::2]]), *_analysis(wavelet), valid, carry=(0, 1))


def _merge(lo, hi, wavelet, valid, length):
    """One level of synthesis, the transpose of `_split`."""
    even, odd = _correlate(jnp.stack([lo, hi]), *_synthesis(wavelet), valid, carry=(1, 0))
    # Interleaved by padding: XLA takes longer to stack along the last axis.
    none, zero = [(0, 0, 0)] * (lo.ndim - 1), jnp.zeros((), lo.dtype)
    x = lax.pad(even, zero, [*none, (0, 1, 1)]) + lax.pad(odd, zero, [*none, (1, 0, 1)])
    return x[..., :length]
