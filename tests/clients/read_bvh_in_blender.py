"""Import a BVH file into Blender and write what is seen there: read_bvh_in_blender.py BVH SCALE FRAMES NPZ."""

import sys

import numpy as np
from blender import fps, heads, imported, names

path, scale, frames, out = sys.argv[1:]
armature = imported(path, global_scale=float(scale))
bones, parents = names(armature)
np.savez(out, bones=bones, parents=parents, heads=heads(armature, 1, int(frames)), fps=fps())
