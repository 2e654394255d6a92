"""What both Blender scripts do: import a BVH file, and read where the bones are."""

import bpy
import numpy as np


def imported(path, **how):
    """The armature that Blender's importer makes of a BVH file, at one Blender frame a BVH frame."""
    bpy.ops.import_anim.bvh(filepath=path, update_scene_fps=True, **how)
    return bpy.context.object


def heads(armature, first, count):
    """Heads of all bones (frame, bone, 3) in world space."""
    found = []
    for frame in range(first, first + count):
        bpy.context.scene.frame_set(frame)
        found.append([armature.matrix_world @ bone.head for bone in armature.pose.bones])
    return np.array(found)


def names(armature):
    """Names of the bones, and of their parents, empty for a root."""
    bones = armature.data.bones
    return [bone.name for bone in bones], [bone.parent.name if bone.parent else "" for bone in bones]


def fps():
    """Frames a second of the scene."""
    render = bpy.context.scene.render
    return render.fps / render.fps_base
