"""The named standard skeletons: joints and bones of common rigs, keypoint sets and marker sets, as tables.

Trees are tokens `joint<parent`; without `<parent`, the parent is the joint before. Graphs are the joints, and chains of
bones `a-b-c`. Keypoints and markers on both sides of a moving trunk are no tree: their bones close cycles, and robust
holds such bones as fast as they vary.
"""

from __future__ import annotations

from itertools import pairwise

_CMU_LEGS_AND_TRUNK = """
    root lhipjoint lfemur ltibia lfoot ltoes rhipjoint<root rfemur rtibia rfoot rtoes
    lowerback<root upperback thorax lowerneck upperneck head """

_MIXAMO_BODY = """
    Hips Spine Spine1 Spine2 Neck Head HeadTop_End
    LeftShoulder<Spine2 LeftArm LeftForeArm LeftHand RightShoulder<Spine2 RightArm RightForeArm RightHand
    LeftUpLeg<Hips LeftLeg LeftFoot LeftToeBase LeftToe_End RightUpLeg<Hips RightLeg RightFoot RightToeBase RightToe_End
    """

_TREES = {
    # CMU motion capture database, ASF/AMC: a joint is named after the bone that ends in it.
    "cmu31": _CMU_LEGS_AND_TRUNK
    + """lclavicle<thorax lhumerus lradius lwrist lhand lfingers lthumb<lwrist
    rclavicle<thorax rhumerus rradius rwrist rhand rfingers rthumb<rwrist""",
    # cmu31 without the six hand and finger joints (Yang et al. 2020, Sec. IV-B).
    "cmu25": _CMU_LEGS_AND_TRUNK + "lclavicle<thorax lhumerus lradius lwrist rclavicle<thorax rhumerus rradius rwrist",
    # The 21 joints of cmu31 that the learned systems keep (Li et al. 2020, Fig. 3; Choi et al. 2024, Fig. 2).
    "cmu21": """root lhipjoint lfemur ltibia ltoes rhipjoint<root rfemur rtibia rtoes
    lowerback<root upperback thorax upperneck
    lclavicle<thorax lhumerus lwrist lhand rclavicle<thorax rhumerus rwrist rhand""",
    # Microsoft Kinect for Windows SDK 2.0, enumeration JointType.
    "kinect25": """SpineBase SpineMid Neck<SpineShoulder Head
    ShoulderLeft<SpineShoulder ElbowLeft WristLeft HandLeft ShoulderRight<SpineShoulder ElbowRight WristRight HandRight
    HipLeft<SpineBase KneeLeft AnkleLeft FootLeft HipRight<SpineBase KneeRight AnkleRight FootRight
    SpineShoulder<SpineMid HandTipLeft<HandLeft ThumbLeft<HandLeft HandTipRight<HandRight ThumbRight<HandRight""",
    # SMPL body model (Loper et al. 2015), in the order of its kinematic tree.
    "smpl24": """pelvis left_hip right_hip<pelvis spine1<pelvis left_knee<left_hip right_knee<right_hip spine2<spine1
    left_ankle<left_knee right_ankle<right_knee spine3<spine2 left_foot<left_ankle right_foot<right_ankle
    neck<spine3 left_collar<spine3 right_collar<spine3 head<neck left_shoulder<left_collar
    right_shoulder<right_collar left_elbow<left_shoulder right_elbow<right_shoulder left_wrist<left_elbow
    right_wrist<right_elbow left_hand<left_wrist right_hand<right_wrist""",
    # Mixamo's rig, there with the prefix `mixamorig:`; mixamo25 has no fingers.
    "mixamo25": _MIXAMO_BODY,
    "mixamo65": _MIXAMO_BODY
    + " ".join(
        f"{side}Hand{finger}1<{side}Hand " + " ".join(f"{side}Hand{finger}{k}" for k in (2, 3, 4))
        for side in ("Left", "Right")
        for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky")
    ),
    # OpenPose BODY_25 (Cao et al. 2019), pairs as it draws them.
    "body25": """Nose<Neck Neck<MidHip RShoulder RElbow RWrist LShoulder<Neck LElbow LWrist MidHip<
    RHip RKnee RAnkle LHip<MidHip LKnee LAnkle REye<Nose LEye<Nose REar<REye LEar<LEye
    LBigToe<LAnkle LSmallToe LHeel<LAnkle RBigToe<RAnkle RSmallToe RHeel<RAnkle""",
}

# Vicon markers of one side and of the middle. In three takes of the CMU database, which has them under other names, the
# pairs vary by 2.5 % of their distance in the median and by 8 % in nine of ten (standard deviation). Thighs hang on the
# back of the pelvis: from there thigh and knee vary by 3 to 7 %, from its front the thigh by up to 28 %.
_VICON_SIDE = """
    LSHO-C7 LSHO-CLAV LSHO-LUPA-LELB-LSHO LELB-LFRM-LWRA-LELB-LWRB-LFRM LWRA-LWRB-LFIN-LWRA
    LKNE-LPSI-LTHI LTHI-LKNE-LTIB-LANK-LKNE LTIB-LHEE-LANK-LTOE-LHEE LBHD-C7 LPSI-T10 """
_VICON_MIDDLE = """LFHD-RFHD-RBHD-LBHD-LFHD-RBHD LBHD-RFHD C7-CLAV-STRN-T10-C7-STRN T10-CLAV C7-RBAK-T10
    LASI-RASI-RPSI-LPSI-LASI-RPSI RASI-LPSI """


def _right(side: str) -> str:
    """The bones of the right half: a marker that starts with an L has one that starts with an R."""
    chains = (chain.split("-") for chain in side.split())
    return " ".join("-".join("R" + name[1:] if name[0] == "L" else name for name in chain) for chain in chains)


_GRAPHS = {
    # COCO keypoints (Lin et al. 2014), bones as the data set lists them.
    "coco17": (
        """nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow
        left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle""",
        """left_ankle-left_knee-left_hip-right_hip-right_knee-right_ankle
        left_hip-left_shoulder-right_shoulder-right_hip left_shoulder-left_elbow-left_wrist
        right_shoulder-right_elbow-right_wrist nose-left_eye-right_eye-nose
        left_eye-left_ear-left_shoulder right_eye-right_ear-right_shoulder""",
    ),
    # MediaPipe Pose (Bazarevsky et al. 2020), POSE_CONNECTIONS. It draws face, mouth and body apart: the mouth is tied
    # to the nose, and the ears to the shoulders as in COCO.
    "mediapipe33": (
        """nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear
        mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist
        left_pinky right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee right_knee
        left_ankle right_ankle left_heel right_heel left_foot_index right_foot_index""",
        """nose-left_eye_inner-left_eye-left_eye_outer-left_ear-left_shoulder
        nose-right_eye_inner-right_eye-right_eye_outer-right_ear-right_shoulder nose-mouth_left-mouth_right-nose
        left_shoulder-right_shoulder-right_hip-left_hip-left_shoulder
        left_shoulder-left_elbow-left_wrist-left_pinky-left_index-left_wrist-left_thumb
        right_shoulder-right_elbow-right_wrist-right_pinky-right_index-right_wrist-right_thumb
        left_hip-left_knee-left_ankle-left_heel-left_foot_index-left_ankle
        right_hip-right_knee-right_ankle-right_heel-right_foot_index-right_ankle""",
    ),
    # Markers of Vicon's full-body Plug-in Gait.
    "plugingait39": (
        """LFHD RFHD LBHD RBHD C7 T10 CLAV STRN RBAK LSHO LUPA LELB LFRM LWRA LWRB LFIN
        RSHO RUPA RELB RFRM RWRA RWRB RFIN LASI RASI LPSI RPSI
        LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE""",
        _VICON_MIDDLE + _VICON_SIDE + _right(_VICON_SIDE),
    ),
}

STANDARDS = (*_TREES, *_GRAPHS)
"""Their names, each with its number of joints."""


def table(name: str) -> tuple[list[str], list[tuple[str, str]]]:
    """Joints and bones of a standard."""
    if name in _GRAPHS:
        joints, chains = _GRAPHS[name]
        return joints.split(), [bone for chain in chains.split() for bone in pairwise(chain.split("-"))]
    tokens = [token.partition("<") for token in _TREES[name].split()]
    joints = [joint for joint, _, _ in tokens]
    parents = [parent if mark else before for (_, mark, parent), before in zip(tokens, ["", *joints], strict=False)]
    return joints, [(parent, joint) for parent, joint in zip(parents, joints, strict=True) if parent]
