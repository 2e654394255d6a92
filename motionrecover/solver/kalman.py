"""The fixed-interval smoother of a body whose joints move on together: linear in frames, exact, with error bars.

Model, for every axis alike (x_t: the coordinate of all S joints in frame t):

    x_t = 2 x_{t-1} - x_{t-2} + w_t,   w_t ~ N(0, a_t Q)        y_t = x_t + e_t,   e_ts ~ N(0, r_ts)

The second difference is the discrete acceleration: its mean path is the cubic smoothing spline (Wahba, "Spline Models
for Observational Data", 1990), with the covariance Q of the joints' accelerations beside it: what moves together is
smoothed together, and a hidden joint is drawn along by the others. The activity a_t lets fast moments be sharp.

Forward, with the state z_t = (x_t, x_{t-1}), x_t = H z_t, z_{t+1} = F z_t + H^T w_{t+1} (Kalman 1960; Joseph's form of
the covariance update, which stays positive definite when r spans nine orders of magnitude):

    V = H P H^T + diag(r),  K = P H^T V^-1,  v = y - H z,  z <- z + K v,  P <- (I - K H) P (I - K H)^T + K diag(r) K^T
    z <- F z,  P <- F P F^T + a Q

Backward, without inverting P (Bryson & Frazier 1963; de Jong, "Smoothing and interpolation with the state-space model",
JASA 84, 1989; Durbin & Koopman 2012, Sec. 4.4-4.5), from g = 0, G = 0 behind the last frame:

    u_t = V^-1 v + K^T g,  U_t = V^-1 + K^T G K (of which the diagonal is needed)
    g <- (I - K H)^T g - H^T V^-1 v,  G <- (I - K H)^T G (I - K H) + H^T V^-1 H
    E[z_t | y] = z - P g,  Var[z_t | y] = P - P G P;  then g <- F^T g,  G <- F^T G F

u / diag(U) is y minus its prediction from all other samples, 1 / diag(U) the variance of that difference, r included.
The first S entries of g and G give the score of the drive: E[w_t | y] = -a_t Q g, Var[w_t | y] = a_t Q - a_t^2 Q G Q.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

SPEED = 0.25
"""Standard deviation of the first step between two frames, in those of where the body is before its first frame. A
joint unseen in the first frames is as uncertain as that many steps, and its variance in the end a small difference of
such numbers: with 1, it comes out negative after 72 frames of a real take."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Smoothed:
    """What the samples say about every frame."""

    mean: Float[Array, "frame joint 3"]
    covariance: Float[Array, "frame joint joint"]
    """Of one axis."""
    error: Float[Array, "frame joint 3"]
    """Each sample minus its prediction from all others."""
    error_variance: Float[Array, "frame joint"]
    """Of one axis of `error`, noise of the sample included."""
    score: Float[Array, "frame joint 3"]
    """g: the smoothed drive is -a Q g."""
    information: Float[Array, "frame joint joint"]
    """G: what is known about the drive; the expectation of score score^T if the model is right."""


def before(sample: Float[Array, "joint 3"], start: Float[Array, ""]) -> tuple[Array, Array]:
    """z (2 joints, 3) and P before the first frame, around its sample: see `smooth`."""
    eye = jnp.eye(len(sample))
    return jnp.concatenate([sample, sample]), start * jnp.block([[eye, eye], [eye, (1 + SPEED**2) * eye]])


def update(
    z: Array, p: Array, y: Float[Array, "joint 3"], r: Float[Array, " joint"]
) -> tuple[tuple[Array, Array], tuple[Array, Array, Array]]:
    """z and P after the samples y of variance r; and v, V^-1 and K."""
    joints = len(y)
    factor = jnp.linalg.cholesky(p[:joints, :joints] + jnp.diag(r))
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(joints))
    gain = p[:, :joints] @ inverse
    innovation = y - z[:joints]
    # H picks columns, so thin products do.
    once = p - gain @ p[:joints]
    after = once - (once[:, :joints] - gain * r) @ gain.T
    return (z + gain @ innovation, after), (innovation, inverse, gain)


def ahead(z: Array, p: Array, drive: Float[Array, "joint joint"]) -> tuple[Array, Array]:
    """z and P of the next frame."""
    joints = len(drive)
    now, last = z[:joints], z[joints:]
    A, B, C = p[:joints, :joints], p[:joints, joints:], p[joints:, joints:]
    cross = 2 * A - B.T
    p = jnp.block([[4 * A - 2 * (B + B.T) + C + drive, cross], [cross.T, A]])
    return jnp.concatenate([2 * now - last, now]), (p + p.T) / 2


def smooth(
    samples: Float[Array, "frame joint 3"],
    noise: Float[Array, "frame joint"],
    drive: Float[Array, "joint joint"],
    activity: Float[Array, " frame"],
    start: Float[Array, ""],
) -> Smoothed:
    """Smooth samples of variance `noise` under the drive covariance Q and activity a, for each axis alike.

    `start`: variance of the position before the first frame, around the first sample. A missing sample is one of a
    variance like `start`: it says nothing that matters.
    """
    joints = samples.shape[1]
    whole = jnp.eye(2 * joints)

    def forward(carry, row):
        z, p = carry
        y, r, a = row
        (now, spread), filtered = update(z, p, y, r)
        return ahead(now, spread, a * drive), (z, p, *filtered)

    def backward(carry, row):
        g, G = carry
        z, p, innovation, inverse, gain = row
        u = inverse @ innovation + gain.T @ g
        # Written out, this loses what long gaps know: beside exact samples G is 1e9 times larger than V^-1 in them.
        kept = whole[:, :joints] - gain
        products = G @ jnp.concatenate([kept, gain], 1)
        once, across = products[:, :joints], products[:, joints:]
        precision = jnp.diag(inverse) + jnp.sum(gain * across, 0)
        g = g.at[:joints].add(-u)
        # H picks columns: the others of I - K H are those of I.
        top = kept.T @ once + inverse
        G = jnp.block([[(top + top.T) / 2, once[joints:].T], [once[joints:], G[joints:, joints:]]])
        now = p[:joints]
        smoothed = (
            z[:joints] - now @ g,
            now[:, :joints] - now @ G @ now.T,
            u / precision[:, None],
            1 / precision,
            g[:joints],
            G[:joints, :joints],
        )
        A, B, C = G[:joints, :joints], G[:joints, joints:], G[joints:, joints:]
        cross = -2 * A - B.T
        G = jnp.block([[4 * A + 2 * (B + B.T) + C, cross], [cross.T, A]])
        return (jnp.concatenate([2 * g[:joints] + g[joints:], -g[:joints]]), G), smoothed

    following = jnp.concatenate([activity[1:], activity[-1:]])
    first = before(samples[0], start)
    _, filtered = lax.scan(forward, first, (samples, noise, following))
    nothing = jax.tree.map(jnp.zeros_like, first)
    _, smoothed = lax.scan(backward, nothing, filtered, reverse=True)
    return Smoothed(*smoothed)


def smooth_each(samples: Array, noise: Array, drive: Array, activity: Array, start: Array) -> Smoothed:
    """`smooth` for a diagonal Q, in which joints know nothing of each other.

    The same recursions with numbers for blocks: P = (A, B; B, C) and G = (D, E; E, F) of each joint.
    """
    q = jnp.diag(drive)
    zero = jnp.zeros_like(q)

    def forward(carry, row):
        x, last, A, B, C = carry
        y, r, a = row
        inverse = 1 / (A + r)
        k1, k2 = A * inverse, B * inverse
        v = y - x
        now, before = x + k1[:, None] * v, last + k2[:, None] * v
        A1, B1, C1 = k1 * r, k2 * r, C - k2 * B
        cross = 2 * A1 - B1
        return (2 * now - before, now, 4 * A1 - 4 * B1 + C1 + a * q, cross, A1), (x, v, A, B, inverse, k1, k2, r)

    def backward(carry, row):
        g1, g2, D, E, F = carry
        x, v, A, B, inverse, k1, k2, r = row
        u = inverse[:, None] * v + k1[:, None] * g1 + k2[:, None] * g2
        precision = inverse + k1 * (D * k1 + E * k2) + k2 * (E * k1 + F * k2)
        kept = r * inverse  # 1 - k1
        once1, once2 = D * kept - E * k2, E * kept - F * k2
        g1, D, E = g1 - u, kept * once1 - k2 * once2 + inverse, once2
        mean = x - A[:, None] * g1 - B[:, None] * g2
        variance = A - A * (D * A + E * B) - B * (E * A + F * B)
        smoothed = mean, variance, u / precision[:, None], 1 / precision, g1, D
        return (2 * g1 + g2, -g1, 4 * D + 4 * E + F, -2 * D - E, D), smoothed

    # Two frames a turn: XLA fuses them, and takes 0.8 of the time.
    following = jnp.concatenate([activity[1:], activity[-1:]])
    first = samples[0], samples[0], zero + start, zero + start, zero + start * (1 + SPEED**2)
    _, filtered = lax.scan(forward, first, (samples, noise, following), unroll=2)
    nothing = jnp.zeros_like(samples[0]), jnp.zeros_like(samples[0]), zero, zero, zero
    _, smoothed = lax.scan(backward, nothing, filtered, reverse=True, unroll=2)
    mean, variance, error, error_variance, score, information = smoothed
    matrix = jax.vmap(jnp.diag)
    return Smoothed(mean, matrix(variance), error, error_variance, score, matrix(information))
