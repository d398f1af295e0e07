# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # Joint limits from a motion
#
# What a shoulder and its elbow did becomes what they may do; another motion is held to it. The page on
# [limits](../docs/limits.md) says how it works.

# %%
import tempfile
from pathlib import Path

import numpy as np

import jaxcap as jc
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.limits.learning.fit_chart import chart_coordinates
from jaxcap.report.limit_pictures import draw_limits
from jaxcap.report.motion_strip import draw_strip

folder = Path(tempfile.mkdtemp())
body = jc.human(resolution="low", joints="tracking")
skeleton = body.skeleton

# %% [markdown]
# A motion of your own comes from `jc.read_bvh`, or `.amc` and `.npz` by `jaxcap.io.registry.read_motion`. Here the
# embedded human walks and waves.

# %%
takes = walk_and_wave(skeleton, seconds=20.0)
samples = jc.limits.gather_samples([(skeleton, takes)], "RightForeArm", "RightArm")
limits = jc.limits.learn_limits(
    {"RightArm": samples.parent, "RightForeArm": samples}, voxel=np.radians(6), keyframe=np.radians(15)
)
[(s.joint, s.parent, s.chart.kind, s.centres.shape[:2]) for s in limits.surfaces]

# %% [markdown]
# Samples, voxels and surface of each joint, in the space of its rotations.

# %%
pictures = []
for surface, one in zip(limits.surfaces, (samples.parent, samples), strict=True):
    parents = (
        None
        if surface.parent_chart is None
        else chart_coordinates(surface.parent_chart, samples.parent.rotations)
    )
    pictures.append(folder / f"{surface.joint}.png")
    draw_limits(pictures[-1], surface, chart_coordinates(surface.chart, one.rotations), parents)

# %% [markdown]
# Another motion, wilder than what was learned from: which frames are beyond, how far, how comfortable they are; and
# the nearest motion that is allowed.

# %%
wild = jc.Motion(jc.body.sample_poses(skeleton, count=60, seed=1), 30.0)
good = np.asarray(jc.limits.allowed_frames(limits, skeleton, wild))
beyond = np.degrees(np.asarray(jc.limits.residual_frames(limits, skeleton, wild)))
comfort = np.asarray(jc.limits.comfort_frames(limits, skeleton, wild))
print(f"{np.mean(~good.all(1)):.0%} of the frames are beyond, by {beyond.max(0).round()} degrees at most")
print(f"comfort {np.median(comfort, 0).round(2)}")

# %%
fixed = jc.limits.project_motion(limits, skeleton, wild)
assert jc.limits.allowed_frames(limits, skeleton, fixed).all()
pictures.append(folder / "strip.png")
draw_strip(
    pictures[-1], skeleton, wild, fixed, ~good, "above as it was, in red what is beyond; below within limits"
)

# %% [markdown]
# In a notebook the pictures show here.

# %%
try:
    from IPython.display import Image, display
except ImportError:
    print(*pictures, sep="\n")
else:
    for picture in pictures:
        display(Image(str(picture)))
