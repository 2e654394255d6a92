"""Live recovery: a frame in, the recovered frame of a moment ago out."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from motionrecover import intake, poses, sliding
from motionrecover.evidence.regression import FRAMES
from motionrecover.skeleton import Skeleton

HURRY, LEISURE, PATIENCE = (40, 4, FRAMES[1:2]), (120, 6, FRAMES[1:2]), (180, 8, FRAMES)
"""Frames of a window before the one that is asked for, steps of the smoother in it, and views of the regression. A CMU
clip with 20 % displaced samples at 120 Hz, 0.25 s: 0.036 mm with 2 steps, 0.029 with 4, 0.038 with 160 frames and 2
steps (`recover`: 0.028). Four at 30 Hz, 1 s: 0.132 mm with 120 frames, 12 steps and a view, 0.130 with 180, 8 and all
(0.119); `mixed` 3.41 and 3.39 mm (2.94), and 3.31 with a window every quarter of the delay, which takes too long."""
ENOUGH = 0.25
"""Seconds from one window to the next that are enough for the second pair, and for the third at up to `SLOW` Hz."""
SLOW = 60.0
LEAST = 3
"""Frames of delay, if any: a third of it passes from one window to the next."""
HOP = 1 / 12
"""Seconds from one window to the next, without a delay."""
EVERY = 0.1
"""Seconds between two frames of the memory: it reaches back 20 s."""
MOST = 10**9
"""Frames from one to the next: at 30 Hz, a year."""
PACE = 0.1
"""Of the difference between a frame's time and its number's, what the clock is set by: sources drift."""


class Stream:
    """The robust recovery of an endless clip, frame by frame, with a constant delay.

    `skeleton` with its bones; lengths are learnt from what is measured, in any unit. `fps`: frames a second of the
    source. `delay` in seconds: `push` returns the frame that lies so far back, rounded to frames. Recovery needs to see
    what comes after: docs/howto/stream.md says what a shorter delay costs. 0 is a filter, which sees the past alone.

    A window of the last frames is recovered every third of the delay, in a thread, while the next frames come
    (`motionrecover.sliding`). Its answer counts from a certain frame on, for which `push` waits if it is not there yet:
    the same frames give the same answers, bit for bit. Memory is bounded, and all compiling is done when the stream is
    made, which takes some seconds for the first of its kind.

    Joints are NaN where nothing says where they are: when nobody is there for more than 10 frames, for one, and until a
    joint was seen at all. Swapped joints are not put right.

    Raises `ValueError` for a rate that is not above 0 and a delay of one or two frames.
    """

    def __init__(self, skeleton: Skeleton, fps: float, delay: float = 0.25):
        if not (np.isfinite(fps) and fps > 0):
            raise ValueError(f"received a frame rate of {fps}: give frames a second, above 0")
        frames = round(delay * fps) if np.isfinite(delay) else -1
        if frames < 0 or 0 < frames < LEAST:
            raise ValueError(
                f"received a delay of {delay} s at {fps} frames a second: give 0, or at least {LEAST} frames "
                f"({LEAST / fps:.3g} s)"
            )
        self.skeleton, self.fps = skeleton, float(fps)
        self.delay = frames
        """Frames from one that is pushed back to the one that is returned."""
        self.dropped = self.repeated = self.late = 0
        """Frames that never came, came again, or came after later ones: known from `time` alone."""
        hop = frames // 3 if frames else max(1, round(HOP * fps))
        # A window's answer is due when the next one begins. Without a delay it is not given out, but remembered.
        back = frames - hop + 1 if frames else 2 * hop + 1
        history, steps, views = HURRY if hop < ENOUGH * fps else PATIENCE if fps <= SLOW else LEISURE
        people = poses.poses_of(skeleton.names)
        self._plan = sliding.Plan(
            edges=skeleton.edges,
            poses=None if people is None else people.thinned(sliding.POSES),
            window=history + back + hop,
            hop=hop,
            back=back,
            stride=max(1, round(EVERY * fps)),
            steps=steps,
            views=views,
            follows=frames == 0,
        )
        joints = len(skeleton.names)
        self._data = np.full((self._plan.window, joints, 3), np.nan)
        self._trust = np.zeros((self._plan.window, joints))
        self._state = sliding.begin(joints)
        self._answers = np.full((hop, joints, 3), np.nan)
        self.frames = 0
        """Taken so far, dropped ones among them."""
        self._since = 0
        self._start: float | None = None
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="motionrecover")
        self._solving: Future[tuple[sliding.Sliding, np.ndarray]] | None = None
        self._compile()

    def __repr__(self) -> str:
        return f"Stream({len(self.skeleton.names)} joints, {self.fps:g} Hz, {self.delay} frames of delay)"

    def push(self, frame: Any, confidence: Any = None, time: float | None = None) -> np.ndarray | None:
        """Take the next frame, and return the recovered one that lies `delay` back; None until there is one.

        `frame` (joint, 3), NaN where missing; `confidence` (joint,) in [0, 1] scales the trust in each sample. The
        answer is (joint, 3), NaN where unknown.

        `time` in seconds, from any start: give it with all frames, or with none. Frames that it shows to be dropped are
        missing ones, and what is returned still lies `delay` back in time. A frame that comes after a later one takes
        its place, if it was missing and still matters; it and one that comes again are counted, and return None.

        Raises `ValueError` for a frame of another shape, confidence outside [0, 1], and a time that is not finite or
        farther back than a window.
        """
        frame, joints = np.asarray(frame), len(self.skeleton.names)
        if frame.shape != (joints, 3):
            raise ValueError(
                f"received a frame of shape {frame.shape}: the stream's skeleton has {joints} joints, "
                f"give ({joints}, 3)"
            )
        if confidence is not None:
            confidence = np.asarray(confidence)[None]
        data, trust = intake.check(frame[None], self.skeleton, confidence=confidence)
        ahead = 1 if time is None else self._frames_ahead(float(time))
        if ahead < 1:
            self._come_late(data[0], trust[0], ahead)
            return None
        self._skip(ahead - 1)
        return self._take(data[0], trust[0])

    def flush(self) -> np.ndarray:
        """The frames that are still to come, (frame, joint, 3); the next push begins another clip of the same body."""
        left = min(self.delay, self.frames - self._since)
        answers = [self._take(*self._nothing) for _ in range(self.delay)][self.delay - left :]
        self._wait()
        self._state = sliding.forget(self._state)
        self._data[:], self._trust[:] = np.nan, 0
        self._since, self._start = self.frames, None
        return np.array(answers).reshape(left, *self._data.shape[1:])

    @property
    def _nothing(self):
        """A frame without a sample."""
        return np.full(self._data.shape[1:], np.nan), np.zeros(self._data.shape[1])

    def _frames_ahead(self, time):
        """How many frames after the last one a time is, by a clock that follows the source's."""
        if not np.isfinite(time):
            raise ValueError(f"received a time of {time}: give seconds")
        if self._start is None:
            self._start = time - (self.frames - self._since) / self.fps
        number = (time - self._start) * self.fps + self._since
        ahead = round(number) - self.frames + 1
        if ahead <= -self._plan.window:
            raise ValueError(
                f"received a time of {time} s, {(1 - ahead) / self.fps:.3g} s before the frame that came last: times "
                "run forward, make another Stream for another recording"
            )
        if ahead > MOST:
            raise ValueError(f"received a time of {time} s, {ahead} frames after the last one: give seconds")
        if ahead >= 1:
            self._start += PACE * (number - round(number)) / self.fps
        return ahead

    def _come_late(self, data, trust, ahead):
        """Count a frame that is not the next one, and put it into its place if that is empty."""
        place = self._plan.window - 1 + ahead
        if self._trust[place].any():
            self.repeated += 1
        else:
            self.late += 1
            self.dropped -= 1
            # The thread may be at work on these.
            self._data, self._trust = self._data.copy(), self._trust.copy()
            self._data[place], self._trust[place] = data, trust

    def _skip(self, missing):
        """Take so many missing frames; of a long break, those that are more than enough to forget the motion count."""
        self.dropped += missing
        hop = self._plan.hop
        spared = max(0, missing - 2 * self._plan.window) // hop * hop
        for _ in range(missing - spared):
            self._take(*self._nothing)
        self.frames += spared

    def _take(self, data, trust):
        """The answer that is due with the next frame."""
        self._data = np.concatenate([self._data[1:], data[None]])
        self._trust = np.concatenate([self._trust[1:], trust[None]])
        self.frames += 1
        now = self.frames % self._plan.hop
        if now == 0:
            self._wait()
            arguments = self._state, self._plan, self._data, self._trust, self.frames
            self._solving = self._pool.submit(sliding.advance, *arguments)
        if self.frames - self._since <= self.delay:
            return None
        if self.delay:
            return self._answers[now].copy()
        if self._state.end is None:
            return np.full(data.shape, np.nan)
        behind = self._plan.hop + now
        return sliding.follow(self._state.end, self._plan, self._data[-behind:], self._trust[-behind:])

    def _wait(self):
        """Have the answer of the window that was solved last."""
        if self._solving is None:
            return
        solving, self._solving = self._solving, None
        try:
            self._state, self._answers = solving.result()
        except np.linalg.LinAlgError:
            # One window of nonsense must not end a live source.
            self._state, self._answers = sliding.forget(self._state), np.full_like(self._answers, np.nan)

    def _compile(self):
        """Have all programs at hand, by a window of a body that hardly moves."""
        rng = np.random.default_rng(0)
        data = rng.normal(size=self._data.shape[1:]) + 1e-3 * rng.normal(size=self._data.shape)
        trust = np.ones(self._trust.shape)
        state, _ = sliding.advance(self._state, self._plan, data, trust, self._plan.window)
        if state.end is not None:
            sliding.follow(state.end, self._plan, data[-1:], trust[-1:])
