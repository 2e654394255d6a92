"""What training does to clean motion, drawn anew for every batch inside the compiled step.

A protocol takes a key and clean motion (batch, frame, joint, 3) in metres, and gives noisy motion and the mask
(batch, frame, joint) of what is observed. `corrupt` of the package has the models for whole clips, in NumPy.

    choi-missing40           each joint of each frame missing with probability 40 % (Choi et al. 2024, Sec. 5.2.1)
    choi-missing20-noise3    20 %, and Gaussian noise of 3 cm an axis on the rest (Sec. 5.2.2, read as centimetres)
    choi-joints2             two joints missing throughout
    li-mixed                 a quarter each of the clips: noise of 1 dB and of 5 dB signal-to-noise ratio, and 30 % and
                             40 % missing with 15 dB on the rest (Li et al. 2020, Sec. IV-A); the signal is the motion
                             about its mean pose
    sensor                   joints as another sensor defines them, all but the first three tenths of the way to the one
                             before, with noise of 1.5 cm an axis and 5 % missing: in place of the recordings of Li et
                             al. 2020, Sec. IV-B, which are not public
    mixed                    each clip: up to 50 % missing at random, up to 3 joints missing throughout, gaps of 5 to 60
                             frames, up to 3 cm of noise, each in half of the clips
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

Clean = Float[Array, "batch frame joint 3"]
Corrupted = tuple[Float[Array, "batch frame joint 3"], Bool[Array, "batch frame joint"]]
Protocol = Callable[[PRNGKeyArray, Clean, Any], Corrupted]
"""Of key, clean motion, and mean pose (joint, 3)."""

PROTOCOLS = ("choi-missing40", "choi-missing20-noise3", "choi-joints2", "li-mixed", "sensor", "mixed")
"""One of each form; the numbers (per cent, centimetres, joints) may be others."""


def protocol(name: str) -> Protocol:
    """The protocol of a name. Raises `ValueError` for a name of no such form."""
    if name == "li-mixed":
        return _li_mixed
    if name == "mixed":
        return _mixed
    if name == "sensor":
        return lambda key, clean, mean: _choi(key, elsewhere(clean), 0.05, 0.015)
    if match := re.fullmatch(r"choi-missing(\d+)(?:-noise(\d+))?", name):
        percent, centimetres = int(match[1]), int(match[2] or 0)
        if percent <= 100:
            return lambda key, clean, mean: _choi(key, clean, percent / 100, centimetres / 100)
    if match := re.fullmatch(r"choi-joints(\d+)", name):
        return lambda key, clean, mean: (clean, _whole_joints(key, clean, int(match[1])))
    raise ValueError(f"received the protocol {name!r}: give one like {', '.join(PROTOCOLS)}")


def elsewhere(clean):
    """Joints (..., joint, 3) as the sensor of `sensor` defines them."""
    before = clean[..., [0, *range(clean.shape[-2] - 1)], :]
    return 0.7 * clean + 0.3 * before


def _choi(key: PRNGKeyArray, clean: Clean, missing: float, sigma: float) -> Corrupted:
    lost, noise = jax.random.split(key)
    observed = jax.random.uniform(lost, clean.shape[:3], jnp.float32) >= missing
    return (_noisy(noise, clean, jnp.float32(sigma)) if sigma else clean), observed


def _li_mixed(key: PRNGKeyArray, clean: Clean, mean: Array) -> Corrupted:
    kind, lost, noise = jax.random.split(key, 3)
    kinds = jax.random.randint(kind, clean.shape[:1], 0, 4)
    decibels, missing = jnp.array([1.0, 5, 15, 15], jnp.float32)[kinds], jnp.array([0, 0, 0.3, 0.4], jnp.float32)[kinds]
    power = ((clean - mean) ** 2).mean((1, 2, 3))
    sigma = jnp.sqrt(power * 10 ** (-decibels / 10))
    observed = jax.random.uniform(lost, clean.shape[:3], jnp.float32) >= missing[:, None, None]
    return _noisy(noise, clean, sigma[:, None, None, None]), observed


def _mixed(key: PRNGKeyArray, clean: Clean, mean: Array) -> Corrupted:
    batch, frames, joints = clean.shape[:3]
    keys = iter(jax.random.split(key, 9))
    does = jax.random.bernoulli(next(keys), 0.5, (4, batch))
    share = 0.5 * jax.random.uniform(next(keys), (batch,), jnp.float32) * does[0]
    observed = jax.random.uniform(next(keys), clean.shape[:3], jnp.float32) >= share[:, None, None]
    count = jax.random.randint(next(keys), (batch,), 1, 4) * does[1]
    rank = jnp.argsort(jax.random.uniform(next(keys), (batch, joints), jnp.float32), -1)
    observed &= (rank >= count[:, None])[:, None]
    length = jax.random.randint(next(keys), (batch, joints), 5, 61)
    start = jax.random.randint(next(keys), (batch, joints), -60, frames)
    now = jnp.arange(frames)[None, :, None]
    struck = jax.random.bernoulli(next(keys), 0.3, (batch, joints)) & does[2][:, None]
    observed &= ~(struck[:, None] & (now >= start[:, None]) & (now < (start + length)[:, None]))
    one, two = jax.random.split(next(keys))
    sigma = 0.03 * jax.random.uniform(one, (batch, 1, 1, 1), jnp.float32) * does[3][:, None, None, None]
    return _noisy(two, clean, sigma), observed


def _whole_joints(key: PRNGKeyArray, clean: Clean, count: int) -> Bool[Array, "batch frame joint"]:
    batch, frames, joints = clean.shape[:3]
    rank = jnp.argsort(jax.random.uniform(key, (batch, joints), jnp.float32), -1)
    return jnp.broadcast_to((rank >= count)[:, None], (batch, frames, joints))


def _noisy(key: PRNGKeyArray, clean: Clean, sigma: Array) -> Clean:
    return clean + sigma * jax.random.normal(key, clean.shape, jnp.float32)
