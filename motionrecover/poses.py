"""The poses that come with the package, for joints of any common rig by their names.

`poses.npz`: 800 poses of 10 people in the CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, created with
funding from NSF EIA-0196217), made by `python -m benchmarks.studies.pose_prior --train`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files

import numpy as np

from motionrecover.evidence.pose_prior import Poses
from motionrecover.io.bones import plain_name
from motionrecover.skeleton import Skeleton

FILE = "poses.npz"
LEAST = 8
"""Joints that must be recognised: fewer show no pose."""

_SAME = {
    "kinect": """root=SpineBase lhipjoint=HipLeft lfemur=KneeLeft ltibia=AnkleLeft lfoot=FootLeft rhipjoint=HipRight
    rfemur=KneeRight rtibia=AnkleRight rfoot=FootRight upperback=SpineMid thorax=SpineShoulder lowerneck=Neck
    upperneck=Head lclavicle=ShoulderLeft lhumerus=ElbowLeft lradius=WristLeft lhand=HandLeft rclavicle=ShoulderRight
    rhumerus=ElbowRight rradius=WristRight rhand=HandRight""",
    "smpl": """root=pelvis lhipjoint=left_hip lfemur=left_knee ltibia=left_ankle lfoot=left_foot rhipjoint=right_hip
    rfemur=right_knee rtibia=right_ankle rfoot=right_foot lowerback=spine1 upperback=spine2 thorax=spine3
    lowerneck=neck upperneck=head lclavicle=left_shoulder lhumerus=left_elbow lradius=left_wrist lhand=left_hand
    rclavicle=right_shoulder rhumerus=right_elbow rradius=right_wrist rhand=right_hand""",
    # Mixamo's names are also those of the BVH files of CMU (cgspeed), whose neck is Neck1.
    "mixamo": """root=Hips lhipjoint=LeftUpLeg lfemur=LeftLeg ltibia=LeftFoot lfoot=LeftToeBase ltoes=LeftToe_End
    rhipjoint=RightUpLeg rfemur=RightLeg rtibia=RightFoot rfoot=RightToeBase rtoes=RightToe_End lowerback=Spine
    upperback=Spine1 thorax=Spine2 lowerneck=Neck lowerneck=Neck1 upperneck=Head head=HeadTop_End lclavicle=LeftArm
    lhumerus=LeftForeArm lradius=LeftHand rclavicle=RightArm rhumerus=RightForeArm rradius=RightHand""",
    "body25": """root=MidHip lhipjoint=LHip lfemur=LKnee ltibia=LAnkle lfoot=LBigToe rhipjoint=RHip rfemur=RKnee
    rtibia=RAnkle rfoot=RBigToe thorax=Neck lclavicle=LShoulder lhumerus=LElbow lradius=LWrist rclavicle=RShoulder
    rhumerus=RElbow rradius=RWrist""",
    # COCO and MediaPipe.
    "keypoints": """lhipjoint=left_hip lfemur=left_knee ltibia=left_ankle lfoot=left_foot_index rhipjoint=right_hip
    rfemur=right_knee rtibia=right_ankle rfoot=right_foot_index lclavicle=left_shoulder lhumerus=left_elbow
    lradius=left_wrist rclavicle=right_shoulder rhumerus=right_elbow rradius=right_wrist""",
}
"""Of each family of rigs, the joints that are where one of the poses is, or in its direction from the joint before."""

NAMES = tuple(name for name in Skeleton.standard("cmu31").names if not name.endswith(("fingers", "thumb")))
"""The joints of the poses: those of cmu31 without fingers and thumbs."""


def poses_of(names: Sequence[str]) -> Poses | None:
    """The poses with the joints `names` of a skeleton, NaN where they have none; None where too few are recognised.

    The family with most of the names gives them their meaning: `LeftFoot` is the ankle in Mixamo's rig, and `left_foot`
    the ball of the foot in SMPL's.
    """
    theirs = [plain_name(name) for name in names]
    joints = max(
        ([table.get(name, -1) for name in theirs] for table in _tables()),
        key=lambda found: np.sum(np.array(found) >= 0),
    )
    joints = np.array([joint if joint not in joints[:k] else -1 for k, joint in enumerate(joints)], int)
    if np.sum(joints >= 0) < LEAST:
        return None
    poses = shipped().of(joints)
    poses.positions[:, joints < 0] = np.nan
    return poses


@lru_cache(maxsize=1)
def shipped() -> Poses:
    """All poses, and their mirror images after them, on the joints `NAMES`."""
    with (files("motionrecover") / FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return with_mirror_images(arrays["positions"].astype(np.float64), arrays["bodies"].astype(int))


def with_mirror_images(positions: np.ndarray, bodies: np.ndarray) -> Poses:
    """Poses from positions (pose, joint, 3) of the joints `NAMES`, x to the side, of bodies numbered from 0."""
    mirrored = positions[:, list(Skeleton(NAMES, []).other_side)] * [-1, 1, 1]
    return Poses(np.concatenate([positions, mirrored]), np.concatenate([bodies, -1 - bodies]))


@lru_cache(maxsize=1)
def _tables() -> list[dict[str, int]]:
    """Of each family the number of a pose's joint by the plain name."""
    number = {name: k for k, name in enumerate(NAMES)}
    pairs = [[word.split("=") for word in words.split()] for words in _SAME.values()]
    return [number, *({plain_name(theirs): number[ours] for ours, theirs in family} for family in pairs)]
