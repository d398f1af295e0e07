# ---
# jupyter:
#   jupytext:
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
from jaxcap.report.render import distinct_colours, draw_surface, frame, turned
from jaxcap.report.scores import score_meshes

VIEW = turned(np.eye(3), 20)

# %% [markdown]
# Meshes of your own come from `jc.read_meshes("meshes/*.obj", unit="mm")`. Here the embedded human strikes ten random poses; nothing of its
# skeleton is told.

# %%
human = jc.human(resolution=400)
poses = jc.sample_poses(human.skeleton, count=10)
vertices = jax.lax.map(lambda pose: jc.pose_body(human, pose).vertices, poses)
meshes = jc.MeshSequence(vertices, human.faces)

figure, plots = plt.subplots(1, 6, figsize=(9.0, 2.2))
for plot, mesh in zip(plots, np.asarray(meshes.vertices[:6], float), strict=True):
    seen = draw_surface(plot, mesh, np.asarray(meshes.faces), VIEW)
    frame(plot, seen.min(0)[:2], seen.max(0)[:2])
plt.show()

# %% [markdown]
# Eight are learned from, two kept back. Three rounds are a quick look; a body to work with takes twenty meshes or more and the rounds that it
# asks for.

# %%
train, rest = meshes[:8], meshes[8:]
learned = jc.learn_body(train, joints=14, rounds=3)
print(f"{learned.body.skeleton.num_joints - 1} joints, {len(learned.pairs)} pairs of left and right")

# %% [markdown]
# The objective falls from step to step, and never rises.

# %%
figure, plot = plt.subplots(figsize=(6.0, 2.6))
values = [value for _, value in learned.history]
plot.plot(values, marker="o", ms=3)
plot.set_xticks(
    range(len(values)), [step for step, _ in learned.history], rotation=60, ha="right", fontsize=7
)
plot.set(ylabel="Q, m²", yscale="log")
plt.show()

# %% [markdown]
# Parts and joints that were found, in the rest pose.

# %%
body = learned.body
parts, parents = np.asarray(body.skin.parts()), body.skeleton.parents
figure, plot = plt.subplots(figsize=(3.6, 4.2))
seen = draw_surface(
    plot,
    np.asarray(body.vertices, float),
    np.asarray(body.faces),
    VIEW,
    distinct_colours(body.skeleton.num_joints)[parts],
    opacity=0.6,
)
centres = np.asarray(body.skeleton.centres) @ VIEW.T
for joint, parent in enumerate(parents):
    if parent > 0:
        plot.plot(*centres[[parent, joint], :2].T, color="#1f2933", lw=1.5)
plot.scatter(*centres[1:, :2].T, s=14, color="#1f2933", zorder=5)
frame(plot, seen.min(0)[:2], seen.max(0)[:2], f"{body.skeleton.num_joints - 1} joints")
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
figure, plots = plt.subplots(2, 2, figsize=(4.2, 4.6))
for column in range(2):
    mesh = np.asarray(rest[column], float)
    found = np.asarray(jc.pose_body(body, fit.motion[column]).vertices, float)
    heat = plt.get_cmap("YlOrRd")(np.clip(np.linalg.norm(found - mesh, axis=1) / 0.03, 0, 1))[:, :3]
    for row, (shape, colours) in enumerate(((mesh, np.array([0.8, 0.79, 0.76])), (found, heat))):
        seen = draw_surface(plots[row, column], shape, np.asarray(meshes.faces), VIEW, colours)
        frame(plots[row, column], seen.min(0)[:2], seen.max(0)[:2], ("held out", "fitted; dark is 3 cm")[row])
plt.show()

# %% [markdown]
# ## To files
#
# `jaxcap track` and `jaxcap fit` take the body; `jc.linearise` and `jc.write_gltf` bring it to other programs ([files](../docs/files.md)).

# %%
folder = Path(tempfile.mkdtemp())
jc.save_body(folder / "body.npz", body)
jc.save_motion(folder / "body-motion.npz", learned.motion, body.skeleton)
sorted(path.name for path in folder.iterdir())
