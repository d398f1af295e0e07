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
# # Learn a body from meshes
#
# Registered meshes of one actor, the same vertices in the same order in every pose, are enough for an animatable body: parts, joints,
# weights, rest shape and all poses. The page on [learning](../docs/learning.md) says how it works.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.report.plots import (
    BLUE,
    PERSON,
    SKIN,
    distance_bar,
    distance_colours,
    draw_person,
    frame_together,
    label_point,
    style_chart,
)
from jaxcap.report.render import INK, distinct_colours, draw_shadow, draw_surface
from jaxcap.report.scores import score_meshes

# %% [markdown]
# Meshes of your own come from `jc.read_meshes("meshes/*.obj", unit="mm")`. Here the embedded human strikes ten random poses; nothing of its
# skeleton is told.

# %%
human = jc.human(resolution=400)
poses = jc.body.sample_poses(human.skeleton, count=10)
vertices = jax.lax.map(lambda pose: jc.pose_body(human, pose).vertices, poses)
meshes = jc.MeshSequence(vertices, human.faces)

figure, plots = plt.subplots(1, 6, figsize=(9.0, 2.6))
figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.9, wspace=0.0)
faces = np.asarray(meshes.faces)
seen = [
    draw_person(plot, mesh - mesh.mean(0), faces)
    for plot, mesh in zip(plots, np.asarray(meshes.vertices[:6], float), strict=True)
]
frame_together(plots, seen, [f"mesh {number}" for number in range(6)])
plt.show()

# %% [markdown]
# Eight are learned from, two kept back. Three rounds are a quick look; a body to work with takes twenty meshes or more and the rounds that it
# asks for.

# %%
train, rest = meshes[:8], meshes[8:]
learned = jc.learn_body(train, joints=14, rounds=3)
print(
    f"{learned.body.skeleton.num_joints - 1} joints, {len(learned.left_right_pairs)} pairs of left and right"
)

# %% [markdown]
# The objective falls from step to step, and never rises.

# %%
steps, values = zip(*learned.history, strict=True)
figure, plot = plt.subplots(figsize=(7.0, 3.2))
plot.semilogy(values, color=BLUE, marker="o", ms=4)
plot.yaxis.set_major_formatter("{x:g}")
plot.yaxis.set_minor_formatter("{x:g}")
plot.set_ylim(None, 1.4 * max(values))
plot.set_xticks(range(len(steps)), steps, rotation=50, ha="right")
for step in (0, len(values) - 1):
    label_point(plot, f"{values[step]:.2g}", (step, values[step]), BLUE, xytext=(0, 8))
style_chart(plot, "No step raises the objective", y_label="Q, m²")
plt.show()

# %% [markdown]
# Parts and joints that were found, in the rest pose.

# %%
body = learned.body
parts, parents = np.asarray(body.skin.dominant_bones()), body.skeleton.parents
surface = np.asarray(body.vertices, float)
figure, plots = plt.subplots(1, 2, figsize=(6.4, 4.6))
figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.93, wspace=0.0)
seen = [
    draw_person(plots[0], surface, faces, colours=distinct_colours(body.skeleton.num_joints)[parts]),
    draw_shadow(plots[1], surface, faces, PERSON),
]
draw_surface(plots[1], surface, faces, PERSON, SKIN, opacity=0.35)
centres = np.asarray(body.skeleton.centres) @ PERSON.T
for joint, parent in enumerate(parents):
    if parent > 0:
        plots[1].plot(*centres[[parent, joint], :2].T, color=INK, lw=2.0, solid_capstyle="round", zorder=4)
plots[1].scatter(*centres[1:, :2].T, s=26, color="white", edgecolors=INK, linewidths=1.2, zorder=5)
frame_together(plots, seen, ["parts", f"{body.skeleton.num_joints - 1} joints"])
plt.show()

# %% [markdown]
# ## What it is worth
#
# The body is posed in the meshes that were kept back, by least squares, and scored: distances from vertex to surface.

# %%
fit = jc.fit_meshes(body, rest)
for name, motion, some in (("training", learned.motion, train), ("held out", fit.motion, rest)):
    scores = score_meshes(body, motion, some, tuple(f"mesh {n}" for n in range(len(some))))
    print(f"{name}: mean {1000 * scores.mean:.1f} mm, vertices {1000 * scores.rmse:.1f} mm")

# %%
FAR = 0.03
figure, plots = plt.subplots(1, 4, figsize=(9.0, 3.8))
figure.subplots_adjust(left=0.0, right=1.0, top=0.92, wspace=0.0)
seen = []
for number in range(2):
    mesh = np.asarray(rest[number], float)
    found = np.asarray(jc.pose_body(body, fit.motion[number]).vertices, float)
    heat = distance_colours()(np.linalg.norm(found - mesh, axis=1) / FAR)[:, :3]
    for column, (shape, colours) in enumerate(((mesh, SKIN), (found, heat))):
        plot = plots[2 * number + column]
        seen.append(draw_person(plot, shape - mesh.mean(0), faces, colours=colours))
frame_together(
    plots, seen, [f"{what}, mesh {number}" for number in range(2) for what in ("held out", "fitted")]
)
distance_bar(figure, FAR, "distance from fitted vertex to true one, mm")
plt.show()

# %% [markdown]
# ## To files
#
# `jaxcap track` and `jaxcap fit` take the body; `jc.edit.to_linear_blend` and `jc.write_gltf` bring it to other programs ([files](../docs/files.md)).

# %%
folder = Path(tempfile.mkdtemp())
jc.save_body(folder / "body.npz", body)
jc.save_motion(folder / "body-motion.npz", learned.motion, body.skeleton)
sorted(path.name for path in folder.iterdir())
