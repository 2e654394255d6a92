"""A plausible moving human made from nothing, for the demo, the tests and the benchmarks.

A plan of footsteps comes first: every foot, the pelvis and the arms follow quintic curves through planned values.
Each leg then follows from its planted foot by two-bone inverse kinematics, and forward kinematics turns joint
rotations and the root track into positions. Bones are therefore rigid, and a planted foot does not slide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

GRAVITY = 9.81
"""Metres a second squared."""

# Rest pose in metres, y up, facing +z, arms along x, for an adult of about 1.75 m (segment lengths after Drillis &
# Contini 1966). Right joints mirror left ones.
_CENTRE = {
    "root": (0, 0, 0),
    "lowerback": (0, 0.12, -0.01),
    "upperback": (0, 0.12, -0.015),
    "thorax": (0, 0.12, 0.005),
    "lowerneck": (0, 0.12, 0),
    "upperneck": (0, 0.085, 0.015),
    "head": (0, 0.2, 0.01),
}
_SIDE = {
    "hipjoint": (0.09, -0.06, 0),
    "femur": (0, -0.43, 0),
    "tibia": (0, -0.425, 0),
    "foot": (0, -0.055, 0.135),
    "toes": (0, -0.008, 0.065),
    "clavicle": (0.18, 0.085, -0.01),
    "humerus": (0.31, 0, 0),
    "radius": (0.17, 0, 0),
    "wrist": (0.085, 0, 0),
}
_BALL_HEIGHT = 0.025
_SIDES = {"l": 1.0, "r": -1.0}
_TALLEST_REACH = 0.992
"""Hip to ankle as a share of the straight leg: no leg stretches further, since a straight knee snaps."""


def synthesize(seconds: float = 8.0, fps: float = 120.0, seed: int = 0) -> Motion:
    """A person who walks, turns, kicks and jumps, on the 25 joints of `cmu25`.

    One round takes 7.5 to 8.5 seconds; a shorter clip is its beginning, a longer one goes on with the next round.
    `seed` varies body, stride, tempo, kick and jump. y is up, the floor is y = 0, positions are metres in float64.
    Samples lie at times k / fps, k = 0 .. round(seconds * fps) - 1, so clips of one seed agree where they overlap.

    Raises `ValueError` for a frame rate or a duration that yields no frame.
    """
    if not (np.isfinite(fps) and fps > 0 and np.isfinite(seconds) and round(seconds * fps) >= 1):
        raise ValueError(
            f"received {seconds} seconds at {fps} frames a second: give positive numbers that make at least one frame"
        )
    rng = np.random.default_rng(seed)
    skeleton = _skeleton(rng)
    plan = _Plan(np.arange(round(seconds * fps)) / fps, skeleton, rng)
    while plan.now < seconds:
        plan.walk()
        plan.turn()
        plan.kick()
        plan.jump()
    note = f"synthesized {seconds} seconds at {fps} frames a second from seed {seed}"
    return Motion(_pose(plan.tracks, skeleton), skeleton, fps, history=(note,))


def _skeleton(rng: np.random.Generator) -> Skeleton:
    """cmu25 with rest offsets of a body between 1.68 and 1.82 m; trunk, legs and arms vary a little on their own."""
    standard = Skeleton.standard("cmu25")
    height = rng.uniform(0.96, 1.04)
    trunk, leg, arm = height * rng.uniform(0.98, 1.02, 3)
    offsets = []
    for name in standard.names:
        if name in _CENTRE:
            offsets.append(trunk * np.array(_CENTRE[name]))
        else:
            part = name[1:]
            scale = arm if part in ("clavicle", "humerus", "radius", "wrist") else leg
            offsets.append(scale * np.array(_SIDE[part]) * (_SIDES[name[0]], 1, 1))
    return Skeleton(standard.names, standard.edges, np.array(offsets))


def _quintic(times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Quintic Hermite curve through `knots` (knot, [time, value, velocity, acceleration]): C2, constant outside."""
    times = np.clip(times, knots[0, 0], knots[-1, 0])
    at = np.clip(np.searchsorted(knots[:, 0], times, side="right") - 1, 0, len(knots) - 2)
    (t0, p0, v0, a0), (t1, p1, v1, a1) = knots[at].T, knots[at + 1].T
    h = t1 - t0
    u = (times - t0) / h
    u3, u4, u5 = u**3, u**4, u**5
    rise = 10 * u3 - 15 * u4 + 6 * u5
    return (
        p0 * (1 - rise)
        + p1 * rise
        + h * (v0 * (u - 6 * u3 + 8 * u4 - 3 * u5) + v1 * (-4 * u3 + 7 * u4 - 3 * u5))
        + h**2 / 2 * (a0 * (u**2 - 3 * u3 + 3 * u4 - u5) + a1 * (u3 - 2 * u4 + u5))
    )


class _Plan:
    """Tracks over time, written act by act.

    Each track is a sum of quintic curves. `root` is the pelvis on the floor, `rise` its height over standing;
    `lfoot`, `rfoot` are the balls of the feet while they bear weight; `lheel`, `rheel` lift the heel about the ball and
    `ltoe`, `rtoe` the toes about the ankle; `lyaw`, `ryaw`, `heading` turn feet and body to the left; `sway` shifts the
    pelvis to the left, `lean` tips the trunk forward and `raise` swings both arms forward. Radians and metres.
    """

    def __init__(self, times: np.ndarray, skeleton: Skeleton, rng: np.random.Generator):
        self.times, self.rng = times, rng
        offsets = dict(zip(skeleton.names, np.array(skeleton.rest_offsets), strict=True))
        self.leg = -offsets["lfemur"][1] - offsets["ltibia"][1]
        self.tempo = rng.uniform(0.93, 1.07)
        self.stride = 0.6 * self.leg / 0.855 * rng.uniform(0.93, 1.07)
        self.kick_angle = np.radians(rng.uniform(58, 76))
        self.jump_height = rng.uniform(0.18, 0.26)
        self.now = 0.35
        self.heading = 0.0
        self.spot = np.zeros(3)
        self.aims: dict[str, np.ndarray] = {}
        self.tracks: dict[str, np.ndarray] = {}
        for name in ("root", "lfoot", "rfoot"):
            self._start(name, np.zeros(3))
        for name in ("heading", "rise", "sway", "lean", "raise", "lyaw", "ryaw", "lheel", "rheel", "ltoe", "rtoe"):
            self._start(name, 0.0)
        for side in _SIDES:
            self._start(f"{side}foot", self._home(side))

    def _start(self, name: str, value: np.ndarray | float) -> None:
        self.aims[name] = np.array(value, float)
        self.tracks[name] = np.tile(self.aims[name], (len(self.times), *[1] * np.ndim(value)))

    def _through(self, name: str, direction: np.ndarray | float, knots: Sequence[Sequence[float]]) -> None:
        """Adds to a track `direction` times the curve through `knots`, rows (time, value[, velocity, acceleration])."""
        table = np.array([(*knot, 0.0, 0.0)[:4] for knot in knots])
        begin, end = np.searchsorted(self.times, table[[0, -1], 0])
        moved = np.concatenate([_quintic(self.times[begin:end], table), np.full(len(self.times) - end, table[-1, 1])])
        self.tracks[name][begin:] += np.multiply.outer(moved, direction)

    def _to(self, name: str, value: np.ndarray | float, start: float, end: float) -> None:
        """Moves a track from its last aim to `value` with minimum jerk (Flash & Hogan 1985)."""
        self._through(name, value - self.aims[name], [(start, 0), (end, 1)])
        self.aims[name] = np.array(value, float)

    def _bump(self, name: str, direction: np.ndarray | float, start: float, end: float) -> None:
        self._through(name, direction, [(start, 0), ((start + end) / 2, 1), (end, 0)])

    @property
    def _forward(self) -> np.ndarray:
        return np.array([np.sin(self.heading), 0, np.cos(self.heading)])

    def _home(self, side: str) -> np.ndarray:
        """Where the ball of a foot belongs when the person stands on `spot`."""
        left = self._forward[::-1] * (1, 1, -1)
        return self.spot + 0.09 * _SIDES[side] * left + (0, _BALL_HEIGHT, 0)

    def _step(self, side: str, length: float, turn: float = 0.0, lift: float = 0.05) -> None:
        """Sets a foot down `length` ahead of the other one; the pelvis stays between the two."""
        beat, start = 0.52 * self.tempo, self.now
        down = start + 0.8 * beat
        behind, self.heading = self.spot, self.heading + turn
        self.spot = self.spot + length * self._forward
        foot, around = f"{side}foot", (start - 0.6 * beat, start + 1.4 * beat)
        push = 0.35 + 0.5 * float(np.linalg.norm(self._home(side) - self.aims[foot]))
        self._to(f"{side}heel", push, start - 0.36 * beat, start + 0.06 * beat)
        self._to(f"{side}heel", 0.0, start + 0.08 * beat, start + 0.7 * beat)
        self._to(f"{side}toe", 0.45 * length, start + 0.4 * beat, down)
        self._to(f"{side}toe", 0.0, down, down + 0.22 * beat)
        self._to(foot, self._home(side), start + 0.08 * beat, down - 0.04 * beat)
        self._bump(foot, np.array([0, lift, 0]), start, down)
        self._to(f"{side}yaw", self.heading, start, down)
        self._to("root", (behind + self.spot) / 2, *around)
        self._to("rise", -0.015 - 0.18 * length**2, start + 0.3 * beat, start + 0.85 * beat)
        self._to("rise", -0.012, start + 0.85 * beat, start + 1.3 * beat)
        self._to("heading", self.heading, *around)
        self._to("sway", -0.025 * _SIDES[side], start - 0.4 * beat, start + 0.3 * beat)
        self.now += beat

    def walk(self) -> None:
        """Four steps, the first from standing."""
        self._to("lean", 0.05, self.now - 0.3, self.now + 0.5)
        self._step("r", self.stride / 2)
        for side in "lrl":
            self._step(side, self.stride * self.rng.uniform(0.95, 1.05))

    def turn(self) -> None:
        """Four short steps to the left, the last one to a stand."""
        angle = np.radians(self.rng.uniform(90, 150))
        self._step("r", self.stride / 2, angle * 0.3)
        self._step("l", self.stride / 3, angle * 0.4)
        self._step("r", 0.0, angle * 0.3)
        self._step("l", 0.0, 0.0, lift=0.03)
        end = self.now
        self._to("lean", 0.0, end - 0.3, end + 0.2)
        self._to("rise", 0.0, end - 0.3, end + 0.2)

    def kick(self) -> None:
        """The right foot swings back, kicks forward at `kick_angle` from the vertical and comes home."""
        t, beat = self.now, self.tempo
        home, reach = self._home("r"), 0.96 * self.leg

        def at(ahead: float, up: float) -> np.ndarray:
            return home + ahead * self._forward + (0, up, 0)

        back, hit, held, chambered, end = t + beat * np.array([0.34, 0.68, 0.73, 1.02, 1.36])
        peak = at(reach * np.sin(self.kick_angle), 0.97 * self.leg - reach * np.cos(self.kick_angle))
        self._to("sway", 0.075, t - 0.2, t + 0.25 * beat)
        self._to("rheel", 0.9, t - 0.12, t + 0.25 * beat)
        self._to("rheel", 0.0, back, hit)
        self._to("rtoe", 0.6, back, hit)
        self._to("rtoe", 0.0, held, end)
        self._bump("rfoot", np.array([0, 0.05, 0]), t - 0.1 * beat, back)
        self._to("rfoot", at(-0.3, 0.14), t, back)
        self._to("rfoot", peak, back, hit)
        self._to("rfoot", at(0.25, 0.3), held, chambered)
        self._to("rfoot", home, chambered, end)
        self._to("lean", 0.12, t, back)
        self._to("lean", -0.22, back, hit)
        self._to("lean", 0.0, held, end)
        self._to("sway", 0.0, chambered, end + 0.15)
        self.now = end + 0.05

    def jump(self) -> None:
        """Crouch, push off, fly under gravity a little forward, land on the balls of the feet and rise."""
        speed = np.sqrt(2 * GRAVITY * self.jump_height)
        crouched = self.now + 0.45 * self.tempo
        off = crouched + 0.34
        apex, landed = off + speed / GRAVITY, off + 2 * speed / GRAVITY
        absorbed, end = landed + 0.26, landed + 0.26 + 0.45 * self.tempo
        heights = [
            (self.now, 0),
            (crouched, -0.27),
            (off, 0.02, speed, -GRAVITY),
            (landed, 0.02, -speed, -GRAVITY),
            (absorbed, -0.2),
            (end, 0),
        ]
        self._through("rise", 1.0, heights)
        self.spot = self.spot + 0.3 * self._forward
        self._to("root", self.spot.copy(), crouched, absorbed)
        # The balls of the feet leave and land 40 ms around the flight of the pelvis: stretched legs need that slack.
        leave, touch = off - 0.04, landed + 0.04
        lift = [(leave, 0), (apex, self.jump_height + 0.08, 0, -GRAVITY), (touch, 0)]
        for side in _SIDES:
            self._through(f"{side}foot", np.array([0, 1, 0]), lift)
            self._to(f"{side}foot", self._home(side), leave + 0.04, touch - 0.04)
            self._to(f"{side}heel", 0.85, off - 0.2, off + 0.02)
            self._to(f"{side}heel", 0.7, apex, landed)
            self._to(f"{side}heel", 0.0, touch, touch + 0.14)
        for name, values in {"lean": (0.65, 0.1, 0.5), "raise": (-0.5, 1.9, 0.5)}.items():
            self._to(name, values[0], self.now, crouched)
            self._to(name, values[1], crouched, apex + 0.1)
            self._to(name, values[2], apex + 0.1, absorbed + 0.1)
            self._to(name, 0.0, absorbed + 0.1, end + 0.2)
        self.now = end + 0.25


def _rotation(axis: int, angle: np.ndarray) -> np.ndarray:
    """Rotations (frame, 3, 3) by `angle` (frame,) about x, y or z (axis 0, 1, 2), right-handed."""
    turn = np.zeros((len(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[:, axis, axis] = 1
    turn[:, i, i] = turn[:, j, j] = np.cos(angle)
    turn[:, j, i] = np.sin(angle)
    turn[:, i, j] = -turn[:, j, i]
    return turn


def _pose(tracks: dict[str, np.ndarray], skeleton: Skeleton) -> np.ndarray:
    """Positions (frame, joint, 3) of the body that follows the tracks."""
    offset = dict(zip(skeleton.names, np.array(skeleton.rest_offsets), strict=True))
    heading, lean = tracks["heading"], tracks["lean"]
    forward = np.stack([np.sin(heading), np.zeros_like(heading), np.cos(heading)], -1)
    left = forward[:, ::-1] * (1, 1, -1)
    # How far the left foot is ahead, saturated: pelvis and arms swing with the legs, the shoulders against them.
    ahead = np.tanh(((tracks["lfoot"] - tracks["rfoot"]) * forward).sum(-1) / 0.5)
    yaws, rolls = heading + ahead[None] * np.linspace(-0.12, 0.16, 4)[:, None], 1.2 * tracks["sway"]
    spine = [
        _rotation(1, yaw) @ _rotation(0, tip * lean) @ _rotation(2, roll * rolls)
        for yaw, tip, roll in zip(yaws, (0.35, 0.6, 0.8, 1.0), (1.0, 0.4, 0.0, -0.2), strict=True)
    ]
    trunk: list[str] = ["root", "lowerback", "upperback", "thorax"]
    turn = dict(zip(trunk, spine, strict=True))
    turn["lowerneck"] = _rotation(1, heading) @ _rotation(0, 0.6 * lean)
    turn["upperneck"] = _rotation(1, heading) @ _rotation(0, 0.4 * lean)

    ankles = {}
    for side in _SIDES:
        yaw, heel, toe = (tracks[side + name] for name in ("yaw", "heel", "toe"))
        flat = _rotation(1, yaw)
        ankles[side] = tracks[f"{side}foot"] - flat @ _rotation(0, heel) @ offset[f"{side}foot"]
        turn[f"{side}tibia"] = flat @ _rotation(0, heel - toe)
        aloft = np.clip((tracks[f"{side}foot"][:, 1] - _BALL_HEIGHT) / 0.1, 0, 1)
        turn[f"{side}foot"] = flat @ _rotation(0, heel * aloft**3 * (10 - 15 * aloft + 6 * aloft**2) - toe)

    # Standing, the balls of the feet are a little ahead of the pelvis, so that the ankles are below the hips.
    root = tracks["root"] + tracks["sway"][:, None] * left - 0.8 * offset["lfoot"][2] * forward
    leg = -offset["lfemur"][1] - offset["ltibia"][1]
    sole = _BALL_HEIGHT - offset["lfoot"][1]
    heights = [sole + 0.985 * leg - offset["lhipjoint"][1] + tracks["rise"]]
    for side in _SIDES:
        hip = turn["root"] @ offset[f"{side}hipjoint"]
        across = (root + hip - ankles[side])[:, [0, 2]]
        drop = np.sqrt((_TALLEST_REACH * leg) ** 2 - (across**2).sum(-1))
        heights.append(ankles[side][:, 1] + drop - hip[:, 1])
    # The planned height, lowered where a leg would not reach its ankle: a minimum smoothed over a centimetre.
    root[:, 1] = -0.01 * np.logaddexp.reduce(-np.array(heights) / 0.01)

    for side, sign in _SIDES.items():
        thigh, shin = -offset[f"{side}femur"][1], -offset[f"{side}tibia"][1]
        turn[f"{side}hipjoint"], turn[f"{side}femur"] = _leg(
            ankles[side] - root - turn["root"] @ offset[f"{side}hipjoint"], turn["root"][:, :, 0], thigh, shin
        )
        swing = 0.12 - 0.6 * sign * ahead + tracks["raise"]
        bend = 0.3 + 0.3 * swing
        shoulder = turn["thorax"] @ _rotation(0, -swing) @ _rotation(2, np.full_like(swing, -1.4 * sign))
        turn[f"{side}clavicle"] = shoulder
        turn[f"{side}humerus"] = shoulder @ _rotation(1, -sign * bend)
        turn[f"{side}radius"] = shoulder @ _rotation(1, -sign * (bend + 0.1))

    positions = np.empty((len(root), len(skeleton.names), 3))
    positions[:, 0] = root
    for parent, child in skeleton.edges:
        names = skeleton.names[parent], skeleton.names[child]
        positions[:, child] = positions[:, parent] + turn[names[0]] @ offset[names[1]]
    return positions


def _leg(reach: np.ndarray, left: np.ndarray, thigh: float, shin: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations of thigh and shin whose ends span `reach` (frame, 3), hip to ankle: the knee bends forward.

    The knee moves in the plane of `reach` and the forward direction across `left`; its angles follow from the law of
    cosines.
    """
    length = np.linalg.norm(reach, axis=-1)
    up = -reach / length[:, None]
    ahead = np.cross(left, up)
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    frame = np.stack([np.cross(up, ahead), up, ahead], -1)
    hip = np.arccos((thigh**2 + length**2 - shin**2) / (2 * thigh * length))
    knee = np.arccos((shin**2 + length**2 - thigh**2) / (2 * shin * length))
    return frame @ _rotation(0, -hip), frame @ _rotation(0, knee)
