"""What a BVH file that Blender exported, and the command rewrote, says of the bones of the armature."""

from math import radians

from mathutils import Euler, Matrix, Vector


def read(path):
    """Channels of each joint, a list of (name, words), and the rows of numbers, one a frame."""
    head, _, motion = path.read_text(encoding="utf-8").partition("\nMOTION")
    joints = []
    for key, *words in (line.split() for line in head.splitlines()):
        if key in ("ROOT", "JOINT"):
            name = " ".join(words)
        elif key == "CHANNELS":
            joints.append((name, words[1:]))
    return joints, [[float(word) for word in line.split()] for line in motion.splitlines()[3:]]


def moves(armature, poses):
    """Each bone's `matrix_basis` in each frame, by bone name: its pose relative to its rest and its parent.

    The file turns a bone about its head, along the axes of the armature; Blender along the axes of the bone at rest.
    """
    joints, rows = poses
    named = {" ".join(bone.name.split()): bone for bone in armature.data.bones}
    bones = [(named[name], words) for name, words in joints]
    found = {bone.name: [] for bone, _ in bones}
    for row in rows:
        frames, posed, values = {}, {}, iter(row)
        for bone, words in bones:
            parent = bone.parent
            local = _local(bone, words, values)
            frames[bone] = frame = frames[parent] @ local if parent else local
            posed[bone] = frame @ bone.matrix_local.to_3x3().to_4x4()
            above = {"parent_matrix": posed[parent], "parent_matrix_local": parent.matrix_local} if parent else {}
            found[bone.name].append(bone.convert_local_to_pose(posed[bone], bone.matrix_local, invert=True, **above))
    return found


def _local(bone, words, values):
    """Matrix of a joint in its parent's frame, from its share of the values."""
    offset = bone.head_local - bone.parent.head_local if bone.parent else bone.head_local
    place, turn = Vector(offset), Vector()
    for word in words:
        axis = "XYZ".index(word[0])
        if word.endswith("position"):
            place[axis] = next(values)
        else:
            turn[axis] = radians(next(values))
    order = "".join(word[0] for word in reversed(words) if word.endswith("rotation"))
    return Matrix.Translation(place) @ Euler(turn, order).to_matrix().to_4x4()
