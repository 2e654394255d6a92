"""The F-curves of an armature's action, in Blender with slots (4.4 and later) and without."""

from itertools import chain
from math import ceil, floor

import bpy
from mathutils import Euler

LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
PATHS = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}


def find(armature):
    """The F-curves that move the armature; None where there are none."""
    data = armature.animation_data
    if data.action is None or not hasattr(data.action, "slots"):
        return data.action and data.action.fcurves
    if data.action_slot is None or not data.action.layers:
        return None
    bag = data.action.layers[0].strips[0].channelbag(data.action_slot)  # Blender has one layer of one strip as yet
    return bag and bag.fcurves


def frames(armature):
    """The first and the last frame with a key."""
    ranges = [curve.range() for curve in find(armature)]
    return floor(min(first for first, _ in ranges)), ceil(max(last for _, last in ranges))


def replace(armature, moves, first):
    """Give the armature a copy of its action, `<name>.clean`, where bones move by `moves`, a matrix each frame.

    Returns the copy. Both actions are kept when the file is saved. Curves of anything but locations and rotations stay
    as they are, and so do the locations of bones that had no curves for them.
    """
    data = armature.animation_data
    old = data.action
    new = old.copy()
    new.name = f"{old.name}.clean"
    old.use_fake_user = new.use_fake_user = True
    slot = getattr(data, "action_slot", None)
    data.action = new
    if slot:
        data.action_slot = next(each for each in new.slots if each.handle == slot.handle)
    fcurves = find(armature)
    for bone in armature.pose.bones:
        path = f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"]'
        place = f"{path}.location"
        if bone.parent is None or any(fcurves.find(place, index=axis) for axis in range(3)):
            _fill(fcurves, place, first, [matrix.to_translation() for matrix in moves[bone.name]])
        turn = PATHS.get(bone.rotation_mode, "rotation_euler")
        _fill(fcurves, f"{path}.{turn}", first, _turns(bone.rotation_mode, moves[bone.name]))
    return new


def _turns(mode, matrices):
    """Rotations in a bone's mode, each as near as it can be to the one before."""
    found = []
    before = Euler((0, 0, 0), "XYZ" if mode in PATHS else mode)
    for matrix in matrices:
        if mode in PATHS:
            now = matrix.to_quaternion()
            if found:
                now.make_compatible(before)
        else:
            now = matrix.to_euler(mode, before)
        before = now
        found.append((now.angle, *now.axis) if mode == "AXIS_ANGLE" else tuple(now))
    return found


def _fill(fcurves, path, first, values):
    """Put a key in each frame from `first` on, into the curves that there are or into new ones."""
    times = range(first, first + len(values))
    for index, column in enumerate(zip(*values, strict=True)):
        curve = fcurves.find(path, index=index) or fcurves.new(path, index=index)
        curve.mute = False
        while curve.modifiers:
            curve.modifiers.remove(curve.modifiers[0])
        points = curve.keyframe_points
        points.clear()
        points.add(len(column))
        points.foreach_set("co", list(chain.from_iterable(zip(times, column, strict=True))))
        points.foreach_set("interpolation", [LINEAR] * len(column))
        curve.update()
