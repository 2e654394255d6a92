"""A Kinect says which joints it tracked, guessed or lost. As confidence, that says how far to believe a guess."""

import numpy as np

import motionrecover as mr

truth = mr.synthesize(6.0, fps=30)
rng = np.random.default_rng(0)
hand = truth.names.index("rwrist")
states = np.full(truth.positions.shape[:2], 2)  # tracked; `mr.load("take.csv")` reads those of a recording
states[60:80, hand], states[80:90, hand] = 1, 0  # behind the body: guessed, then lost
positions = truth.positions + 0.004 * rng.normal(size=truth.positions.shape)
positions[60:80, hand] = positions[60, hand]  # the guess: where it was last seen, while the person walks on

# Confidence of the states lost, guessed and tracked; loaded files have the second.
for trust in ([0.0, 1.0, 1.0], [0.0, 0.3, 1.0], [0.0, 0.0, 1.0]):
    confidence = np.array(trust)[states]
    found = mr.recover(positions, truth.skeleton, fps=truth.fps, confidence=confidence)
    error = 1000 * np.linalg.norm(found.positions - truth.positions, axis=-1)[60:90, hand]
    print(f"guesses of confidence {trust[1]:.1f}: the hand is off by {error.mean():.0f} mm in the mean there")
