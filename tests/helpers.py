"""What the tests share: a catalogue of skeletons and clips, and one table of tolerances."""

import jax.numpy as jnp
import numpy as np

from motionrecover import Skeleton
from motionrecover.programs import bucket
from motionrecover.solver import Problem

TOLERANCE = {
    "orthogonality": 1e-12,  # W^T W - I, float64
    "adjoint": 1e-12,  # <J v, r> - <v, J^T r>, relative, float64
    "linear solve": 1e-8,  # tree against PCG against dense, relative, float64
    "stiff float32": 1e-5,  # the step on a tree in float32 at gamma |d|^2 / rho = 1e5, relative
    "one step": 1e-6,  # one Gauss-Newton step against jaxopt, which solves for it by conjugate gradients, metres
    "minimiser": 1e-7,  # Gauss-Newton steps to their end against optimistix, metres
    "svd": 1e-12,  # singular value threshold against numpy.linalg.svd, relative, float64
    "svd float32": 3e-6,  # the same in float32 with a float64 Gram matrix
    "svd float32 alone": 1e-3,  # the same where JAX has no float64: the error is at most about the threshold
    "brute force": 1e-6,  # prox against minimisation on its definition
    "objective": 1e-4,  # the convex case against an interior-point solver, relative
    "planted": 1e-5,  # low rank + sparse truth, relative
    "residual": 1e-5,  # both residuals with constant penalties, float64
    "equivariance": 1e-6,  # metres, float64, between runs that differ by a symmetry of the model
    "posterior": 1e-8,  # recursive smoothing against solving for all frames at once
    "padding": 1e-4,  # a clip stored in another length, of the size of the motion
    "parts": 1e-3,  # metres, a take in parts against the whole, where all parts find the same bones
    "float32": 2e-4,  # metres, float32 against float64 after the same number of steps
    "inverse kinematics": 2e-5,  # metres a coordinate: its steps end 1e-5 from the target
    "weak direction": 5e-4,  # metres: positions that hardly show a turn are traded for keeping it
    "written digits": 5e-6,  # metres: BVH with six decimals, which add up along a chain
    "other programs": 2e-5,  # metres: BVH in Blender, which computes in float32
    "network": 1e-5,  # of numbers about 1, a network in float32 against its definition
    "reference": 1e-7,  # metres, against the NumPy/SciPy reference after the same number of steps, float64
}

TREES = {
    "bone": Skeleton(["a", "b"], [(0, 1)]),
    "chain": Skeleton("abcde", [(0, 1), (1, 2), (2, 3), (3, 4)]),
    "chain upwards": Skeleton("abcd", [(3, 2), (2, 1), (1, 0)]),
    "star": Skeleton("abcdef", [(0, k) for k in range(1, 6)]),
    "cmu25": Skeleton.standard("cmu25"),
    "kinect25": Skeleton.standard("kinect25"),
}
GRAPHS = {
    "triangle": Skeleton("abc", [(0, 1), (1, 2), (2, 0)]),
    "braced": Skeleton("abcdef", [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (3, 4), (4, 5), (5, 1)]),
}
SKELETONS = TREES | GRAPHS
SMALL_BODY = Skeleton(["root", "hip", "knee", "chest", "hand"], [(0, 1), (1, 2), (0, 3), (3, 4)])
"""For networks, which take long to compile."""


def clip(skeleton: Skeleton, frames: int, seed: int = 0) -> np.ndarray:
    """A smooth motion (frame, joint, 3) in metres whose bones keep their length: a body that turns, bends and walks.

    A tree bends at its joints; a graph with cycles only turns as a whole.
    """
    rng = np.random.default_rng(seed)
    joints = len(skeleton.names)
    t = np.linspace(0, 1, frames)[:, None]
    walk = np.concatenate([1.5 * t, 0.05 * np.sin(9 * t), 0.3 * np.sin(3 * t)], 1)[:, None]
    if not skeleton.is_forest:
        body, angle = rng.normal(scale=0.3, size=(joints, 3)), 2 * t
        x, y, z = body.T
        turned = [np.cos(angle) * x + np.sin(angle) * z, y + 0 * angle, np.cos(angle) * z - np.sin(angle) * x]
        return np.stack(turned, -1) + walk
    positions = np.zeros((frames, joints, 3))
    placed, bones = {skeleton.components[0][0]}, list(skeleton.edges)
    while bones:
        i, j = next(bone for bone in bones if placed & set(bone))
        bones.remove((i, j))
        known, new = (i, j) if i in placed else (j, i)
        direction = rng.normal(size=3) + 0.3 * np.sin(2 * np.pi * t * rng.uniform(0.5, 2)) * rng.normal(size=3)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        positions[:, new] = positions[:, known] + rng.uniform(0.1, 0.5) * direction
        placed.add(new)
    return positions + walk


def lengths_of(skeleton: Skeleton, positions: np.ndarray) -> np.ndarray:
    """True bone lengths (bone,) of a rigid clip."""
    return skeleton.bone_lengths_of(positions).mean(0)


def hit(positions: np.ndarray, fraction: float, seed: int = 0) -> np.ndarray:
    """The clip with a fraction of its samples displaced by up to 25 cm an axis."""
    rng = np.random.default_rng(seed)
    thrown = rng.random(positions.shape[:2]) < fraction
    return np.where(thrown[..., None], positions + rng.uniform(-0.25, 0.25, positions.shape), positions)


def problem_of(
    skeleton: Skeleton, positions: np.ndarray, lengths: np.ndarray, dtype: type = np.float64, stored: int | None = None
) -> Problem:
    """The solver's problem for complete data centred at its mean, stored in `stored` frames."""
    frames = len(positions)
    pad = (0, (stored or bucket(frames)) - frames)
    centred = (positions - positions.mean((0, 1))).transpose(2, 1, 0)
    return Problem(
        positions=jnp.asarray(np.pad(centred, ((0, 0), (0, 0), pad)), dtype),
        weights=jnp.asarray(np.pad(np.ones((centred.shape[1], frames)), ((0, 0), pad)), dtype),
        bone_lengths=jnp.asarray(lengths, dtype),
        frames=jnp.asarray(frames, jnp.int32),
        edges=skeleton.edges,
    )
