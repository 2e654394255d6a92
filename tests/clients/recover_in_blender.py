"""Install the extension, run Recover Motion on an imported BVH file, and write what became of it.

recover_in_blender.py EXTENSION COMMAND BVH KIND FOLDER: into FOLDER go exported.bvh, which is what the command has to
see, and seen.npz.
"""

import subprocess
import sys
from math import pi
from pathlib import Path

import bpy
import numpy as np
from blender import fps, heads, imported, names

FIRST = 11
KINDS = {
    "as imported": {},
    # What FBX importers make: y up and centimetres inside, turned and scaled as an object.
    "as from FBX": {"axis_forward": "Y", "axis_up": "Z", "global_scale": 100, "rotate_mode": "QUATERNION"},
}


def install(extension, folder):
    """Build the extension as Blender's command line does, install and enable it; its preferences."""
    package = folder / "motionrecover.zip"
    tool = Path(bpy.utils.system_resource("SCRIPTS"), "addons_core", "bl_pkg", "cli", "blender_ext.py")
    build = ["build", "--source-dir", extension, "--output-filepath", str(package)]
    subprocess.run([sys.executable, str(tool), *build], check=True, stdout=subprocess.DEVNULL)
    bpy.ops.extensions.package_install_files(filepath=str(package), repo="user_default", enable_on_install=True)
    return bpy.context.preferences.addons["bl_ext.user_default.motionrecover"].preferences


def curves(armature):
    """Keys (key, 2) of the action that the armature has, by path and index."""
    data = armature.animation_data
    action = data.action
    found = action.layers[0].strips[0].channelbag(data.action_slot) if hasattr(action, "slots") else action
    keys = {}
    for curve in found.fcurves:
        keys[f"{curve.data_path} {curve.array_index}"] = [tuple(point.co) for point in curve.keyframe_points]
    return keys


def refusal(**options):
    """What Recover Motion says when it refuses."""
    try:
        bpy.ops.armature.recover_motion(**options)
    except RuntimeError as error:
        return str(error).strip()
    return ""


extension, command, path, kind, folder = sys.argv[1:]
folder = Path(folder)
preferences = install(extension, folder)
armature = imported(path, frame_start=FIRST, **KINDS[kind])
if kind == "as from FBX":
    armature.rotation_euler, armature.scale = (pi / 2, 0, 0), (0.01, 0.01, 0.01)
armature["mood"] = 1.0
armature.keyframe_insert('["mood"]', frame=FIRST)
bpy.context.view_layer.update()
data = armature.animation_data
original, before = data.action, curves(armature)
count = len(before[f'pose.bones["{armature.data.bones[0].name}"].location 0'])
bpy.ops.export_anim.bvh(filepath=str(folder / "exported.bvh"), frame_start=FIRST, frame_end=FIRST + count - 1)

preferences.command = "no-such-command"
refusals = [refusal()]
preferences.command = str(folder / "broken")
refusals.append(refusal())
preferences.command = command
armature.rotation_euler.x += 0.5
bpy.context.view_layer.update()
refusals.append(refusal(plant_feet=True))
armature.rotation_euler.x -= 0.5
constraint = armature.pose.bones[3].constraints.new("COPY_ROTATION")
refusals.append(refusal())
armature.pose.bones[3].constraints.remove(constraint)
assert len(bpy.data.actions) == 1
assert data.action == original

assert bpy.ops.armature.recover_motion() == {"FINISHED"}
clean, after = data.action, curves(armature)
recovered = heads(armature, FIRST, count)
data.action = original
bones, parents = names(armature)
np.savez(
    folder / "seen.npz",
    bones=bones,
    parents=parents,
    heads=recovered,
    fps=fps(),
    kept=before == curves(armature),
    same_curves=sorted(before) == sorted(after),
    mood=after['["mood"] 0'] == before['["mood"] 0'],
    actions=[original.name, clean.name],
    fake_users=[original.use_fake_user, clean.use_fake_user],
    refusals=refusals,
)
