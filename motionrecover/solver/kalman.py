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

The smoother takes two frames at a time, all that z holds: H is the identity for the samples of both, and two moves
ahead follow. Half as many updates of as much work take 0.8 of the time. Then I - K = diag(r) V^-1, which no rounding
spoils, and P <- (I - K) P is as accurate as Joseph's form: beside arithmetic of 256 bits, variances of clips with long
gaps and exact samples come out within 2 to 20 % in the worst sample of either, means within 1e-6 of their error.

Backward, without inverting P (Bryson & Frazier 1963; de Jong, "Smoothing and interpolation with the state-space model",
JASA 84, 1989; Durbin & Koopman 2012, Sec. 4.4-4.5), from g = 0, G = 0 behind the last pair:

    u = V^-1 v + K^T g,  U = V^-1 + K^T G K (of which the diagonal is needed)
    g <- (I - K)^T g - V^-1 v,  G <- (I - K)^T G (I - K) + V^-1
    E[z | y] = z - P g,  Var[z | y] = P - P G P;  then twice  g <- F^T g,  G <- F^T G F

u / diag(U) is y minus its prediction from all other samples, 1 / diag(U) the variance of that difference, r included.
The first S entries of g and G before each move back give the score of the drive: E[w_t | y] = -a_t Q g,
Var[w_t | y] = a_t Q - a_t^2 Q G Q.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from motionrecover.kernel import one_kernel

SPEED = 0.25
"""Standard deviation of the first step between two frames, in those of where the body is before its first frame. A
joint unseen in the first frames is as uncertain as that many steps, and its variance in the end a small difference of
such numbers: with 1, it comes out negative after 72 frames of a real take."""
NOTHING = 1e9
"""Variance, in those of where the body is before its first frame, of a sample that says nothing."""


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


def update(z: Array, p: Array, y: Float[Array, "joint 3"], r: Float[Array, " joint"]) -> tuple[Array, Array]:
    """z and P after the samples y of variance r."""
    joints = len(y)
    gain = p[:, :joints] @ _inverse(p[:joints, :joints] + jnp.diag(r))
    # H picks columns, so thin products do.
    once = p - gain @ p[:joints]
    return z + gain @ (y - z[:joints]), once - (once[:, :joints] - gain * r) @ gain.T


def _inverse(v):
    """Of a positive definite matrix: the product of two triangles takes half as long as solving for the second."""
    root = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(v), jnp.eye(len(v)), trans=1, lower=True)
    return root @ root.T


def ahead(z: Array, p: Array, drive: Float[Array, "joint joint"]) -> tuple[Array, Array]:
    """z and P of the next frame."""
    joints = len(drive)
    now, last = z[:joints], z[joints:]
    A, B, C = p[:joints, :joints], p[:joints, joints:], p[joints:, joints:]
    cross = 2 * A - B.T
    p = jnp.block([[4 * A - 2 * (B + B.T) + C + drive, cross], [cross.T, A]])
    return jnp.concatenate([2 * now - last, now]), (p + p.T) / 2


def _two_ahead(z, p, drives):
    """`ahead` twice."""
    first, second = drives
    return ahead(*ahead(z, p, first), second)


def back(g: Array, G: Array) -> tuple[Array, Array]:
    """g and G behind the samples of the frame before."""
    joints = len(g) // 2
    now, last = g[:joints], g[joints:]
    A, B, C = G[:joints, :joints], G[:joints, joints:], G[joints:, joints:]
    cross = -2 * A - B.T
    return jnp.concatenate([2 * now + last, -now]), jnp.block([[4 * A + 2 * (B + B.T) + C, cross], [cross.T, A]])


def _gone_back(g, G, inverse):
    """G with what the samples add, exactly symmetric, and `back` from there, once and twice."""
    G = G + inverse
    G = (G + G.T) / 2
    once = back(g, G)
    return G, once, back(*once)


def smooth(
    samples: Float[Array, "frame joint 3"],
    noise: Float[Array, "frame joint"],
    drive: Float[Array, "joint joint"],
    activity: Float[Array, " frame"],
    start: Float[Array, ""],
) -> Smoothed:
    """Smooth samples of variance `noise` under the drive covariance Q and activity a, for each axis alike.

    `start`: variance of the position before the first frame, around the first sample. A missing sample is one of
    `NOTHING` times that variance.
    """
    frames, joints = noise.shape
    whole = jnp.eye(2 * joints)
    odd = frames % 2
    samples = jnp.pad(samples, [(0, odd), (0, 0), (0, 0)], "edge")
    noise = jnp.pad(noise, [(0, odd), (0, 0)], constant_values=NOTHING * start)
    activity = jnp.pad(activity, (0, odd + 2), "edge")

    def paired(x):
        """The frames in twos, the later one first: as in z."""
        return x.reshape(-1, 2, *x.shape[1:])[:, ::-1].reshape(-1, 2 * joints, *x.shape[2:])

    def split(x):
        """A pair's entries by frame, the earlier one first."""
        return x.reshape(2, joints, *x.shape[1:])[::-1]

    def forward(carry, row):
        (z, p), (y, r, (a, b)) = carry, row
        inverse = _inverse(p + jnp.diag(r))
        innovation = y - z
        kept = r[:, None] * inverse
        seen = y - kept @ innovation, kept @ p
        return one_kernel(_two_ahead)(*seen, (a * drive, b * drive)), (*carry, r, innovation, inverse)

    def backward(carry, row):
        g, G = carry
        z, p, r, innovation, inverse = row
        kept = r[:, None] * inverse
        once = G @ kept
        precision = jnp.diag(inverse) + jnp.sum((whole - kept) * (G - once), 0)
        rest = inverse @ (r[:, None] * g - innovation)
        u, g = g - rest, rest
        # Multiplied out, this loses what long gaps know: beside exact samples, G is 1e9 times larger than V^-1 in them.
        G, between, carry = one_kernel(_gone_back)(g, (inverse * r) @ once, inverse)
        known = p @ G
        last, now = slice(joints, None), slice(joints)
        covariance = [p[x, x] - known[x] @ p[:, x] for x in (last, now)]
        smoothed = (
            split(z - p @ g),
            jnp.stack(covariance),
            split(u / precision[:, None]),
            split(1 / precision),
            jnp.stack([between[0][now], g[now]]),
            jnp.stack([between[1][now, now], G[now, now]]),
        )
        return carry, smoothed

    z, p = before(samples[0], start)
    first = ahead(z, p, activity[1] * drive)
    _, filtered = lax.scan(forward, first, (*map(paired, (samples, noise)), activity[2:].reshape(-1, 2)))
    nothing = jax.tree.map(jnp.zeros_like, first)
    _, smoothed = lax.scan(backward, nothing, filtered, reverse=True)
    return Smoothed(*(x.reshape(-1, *x.shape[2:])[:frames] for x in smoothed))


def smooth_each(samples: Array, noise: Array, drive: Array, activity: Array, start: Array) -> Smoothed:
    """`smooth` for a diagonal Q, in which joints know nothing of each other.

    The recursions frame by frame, with numbers for blocks: P = (A, B; B, C) and G = (D, E; E, F) of each joint.
    """
    answer = one_kernel(_smooth_each)(samples, noise, jnp.diag(drive), activity, start)
    mean, variance, error, error_variance, score, information = answer
    matrix = jax.vmap(jnp.diag)
    return Smoothed(mean, matrix(variance), error, error_variance, score, matrix(information))


def _smooth_each(samples, noise, q, activity, start):
    """With the diagonals for matrices."""
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

    following = jnp.concatenate([activity[1:], activity[-1:]])
    first = samples[0], samples[0], zero + start, zero + start, zero + start * (1 + SPEED**2)
    _, filtered = lax.scan(forward, first, (samples, noise, following))
    nothing = jnp.zeros_like(samples[0]), jnp.zeros_like(samples[0]), zero, zero, zero
    return lax.scan(backward, nothing, filtered, reverse=True)[1]
