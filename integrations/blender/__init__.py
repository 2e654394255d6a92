"""Recover Motion: cleans the action of an armature with the command `motionrecover`, and keeps the original.

The pose goes out as BVH through Blender's own exporter, frame by frame and in the space of the armature, the command
recovers it, and what it wrote becomes the rotations and locations of a copy of the action. Nothing of the command runs
inside Blender.
"""

import json
import subprocess
import tempfile
from pathlib import Path

import bpy
from mathutils import Vector

from . import bvh, curves

UPRIGHT = 0.99
"""Cosine between an axis of the armature and up, from which on its floor is level: 8 degrees."""
ALIKE = 0.01
"""Share by which the scales along the axes may differ."""


class RefusedError(Exception):
    """One sentence for the person: what is in the way, and what to do."""


class Preferences(bpy.types.AddonPreferences):
    """Where the command is."""

    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Command", description="The motionrecover command, by name or path", default="motionrecover"
    )

    def draw(self, context):
        """One line."""
        self.layout.prop(self, "command")


class ARMATURE_OT_recover_motion(bpy.types.Operator):
    """Clean the action of this armature of jitter, spikes and lost joints, as a new action beside it"""

    bl_idname = "armature.recover_motion"
    bl_label = "Recover Motion"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    max_gap: bpy.props.IntProperty(
        name="Longest Gap", description="Leave longer runs of lost frames as they are; 0 fills them all", min=0
    )
    plant_feet: bpy.props.BoolProperty(
        name="Plant Feet", description="Hold feet in place while they stand on the ground"
    )

    @classmethod
    def poll(cls, context):
        """Whether there is an armature with an action."""
        armature = context.object
        if armature is None or armature.type != "ARMATURE" or armature.mode == "EDIT":
            cls.poll_message_set("select an armature, in Object or Pose Mode")
            return False
        if armature.animation_data is None or not curves.find(armature):
            cls.poll_message_set("the armature has no action")
            return False
        return True

    def invoke(self, context, event):
        """Ask for the options."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context):
        """Recover; the cleaned action becomes the armature's."""
        if context.window:
            context.window.cursor_set("WAIT")
        try:
            name, facts = self._recover(context)
        except RefusedError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if context.window:
                context.window.cursor_set("DEFAULT")
        if not facts["converged"]:
            self.report({"WARNING"}, facts["message"])
        counts = ", ".join(f"{count} {kind}" for kind, count in facts["samples"].items() if count)
        self.report({"INFO"}, f"{name}: samples of joints {counts}")
        return {"FINISHED"}

    def _recover(self, context):
        armature, render = context.object, context.scene.render
        check(armature)
        first, last = curves.frames(armature)
        if first == last:
            raise RefusedError("the action has keys in one frame only: there is nothing to recover from")
        options = ["--up", up_axis(armature, level=self.plant_feet), "--fps", repr(render.fps / render.fps_base)]
        if self.max_gap:
            options += ["--max-gap", str(self.max_gap)]
        if self.plant_feet:
            options += ["--plant-feet"]
        command = context.preferences.addons[__package__].preferences.command
        with tempfile.TemporaryDirectory(prefix="motionrecover") as folder:
            given, answer = Path(folder, "action.bvh"), Path(folder, "clean.bvh")
            bpy.ops.export_anim.bvh(filepath=str(given), frame_start=first, frame_end=last)
            facts = run(command, ["recover", str(given), "-o", str(answer), "--json", *options])
            poses = bvh.read(answer)
        return curves.replace(armature, bvh.moves(armature, poses), first).name, facts


class VIEW3D_PT_recover_motion(bpy.types.Panel):
    """A button in the sidebar of the 3D view."""

    bl_label = "Recover Motion"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Animation"

    @classmethod
    def poll(cls, context):
        """Whether there is an armature."""
        return context.object is not None and context.object.type == "ARMATURE"

    def draw(self, context):
        """The button."""
        self.layout.operator(ARMATURE_OT_recover_motion.bl_idname)


def check(armature):
    """Refuse poses that are more than an action of one hierarchy; Blender would apply the rest a second time."""
    if not hasattr(bpy.types, "EXPORT_ANIM_OT_bvh"):
        raise RefusedError("Blender's BVH exporter is switched off: enable the add-on BVH in the preferences")
    roots = [bone.name for bone in armature.data.bones if bone.parent is None]
    if len(roots) != 1:
        raise RefusedError(f"one root bone is needed, this armature has {len(roots)}: {', '.join(roots[:3])}")
    bound = [bone.name for bone in armature.pose.bones if any(not each.mute for each in bone.constraints)]
    if bound:
        raise RefusedError(f"{', '.join(bound[:3])} are constrained: bake the action first (Pose > Animation)")
    data = armature.animation_data
    if data.use_nla and any(not track.mute for track in data.nla_tracks):
        raise RefusedError("the NLA plays into the pose: mute its tracks, or bake the action first")
    scale = armature.matrix_world.to_scale()
    if max(scale) - min(scale) > ALIKE * max(scale):
        raise RefusedError("the scale of the armature is not the same along its axes: apply it (Ctrl A)")


def up_axis(armature, level):
    """The axis of the armature that points up, as `--up` wants it; refused where `level` and it leans."""
    up = (armature.matrix_world.inverted().to_3x3() @ Vector((0, 0, 1))).normalized()
    axis = max(range(3), key=lambda axis: abs(up[axis]))
    if level and up[axis] < UPRIGHT:
        raise RefusedError("no axis of the armature points up, so its floor is not known: apply its rotation (Ctrl A)")
    return "xyz"[axis]


def run(command, arguments):
    """The facts that the command prints. Raises `RefusedError` with what it says is wrong."""
    try:
        done = subprocess.run(
            [bpy.path.abspath(command), *arguments],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # Windows opens a console otherwise
        )
    except OSError as error:
        raise RefusedError(
            f"cannot run {command} ({error.strerror}): install motionrecover, or give its path in the preferences of "
            "this extension"
        ) from error
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"{command} ended with code {done.returncode}"]
        raise RefusedError(said[-1].removeprefix("error: "))
    return json.loads(done.stdout)


CLASSES = (Preferences, ARMATURE_OT_recover_motion, VIEW3D_PT_recover_motion)


def _menu(self, context):
    self.layout.separator()
    self.layout.operator(ARMATURE_OT_recover_motion.bl_idname)


def register():
    """Called by Blender."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.VIEW3D_MT_object_animation.append(_menu)


def unregister():
    """Called by Blender."""
    bpy.types.VIEW3D_MT_object_animation.remove(_menu)
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
