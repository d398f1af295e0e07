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
# # A template becomes the actor
#
# Noisy, partial scans that are not registered to anything; the template's size, build, joints and surface change until they are those of the
# person who was scanned. The page on [adaptation](../docs/adaptation.md) says how it works. Here are six scans and a few short rounds, to be
# done in a minute; a result to work with takes forty frames and all rounds.

# %%
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.demo.performance import walk_and_wave
from jaxcap.report.render import draw_surface, frame, turned

VIEW = turned(np.eye(3), 25)

# %% [markdown]
# The actor: a woman, small and heavier than the template, seen by four cameras with 3 mm of noise.

# %%
actor = jc.human(sex="female", age=45, weight=0.8, height=1.6, resolution="low", joints="tracking")
motion = walk_and_wave(actor.skeleton, seconds=2.0)
chosen = (0, 12, 24, 36, 48, 59)
posed = [jc.pose_body(actor, motion[number]) for number in chosen]
cameras = jc.ring_of_cameras(4, 360, distance=2.5, height=0.6, target=[0.0, 0.0, 0.0], resolution=(160, 160))
scanner = jc.Scanner(noise=0.003, points=3000)
scans = [
    jc.scan_frame(scanner, cameras, np.asarray(one.vertices, float), np.asarray(actor.faces), frame=number)
    for number, one in enumerate(posed)
]
clouds = [jc.make_cloud(scan.points, scan.normals) for scan in scans]

# %% [markdown]
# The template is a man of average build, its first pose near that of the first scan. What stays the same through all stages is a task; a stage
# at a time comes back. The command is `jaxcap adapt human "scans/*.ply" -o actor.npz`.

# %%
template = jc.human(resolution="low", joints="tracking")
task = jc.make_adapt_task(
    template,
    clouds,
    start=jc.rest_pose(template.skeleton),
    settings=jc.AdaptSettings(frames=4, alone=3, rounds=(2,), temporal=0.0),
)
states = []
for state in jc.adapt_body(task):
    states.append(state)
    print(
        f"{state.history[-1][0]}: {state.history[-1][1]:.1f} mm from scan to body, root mean square of pairs"
    )

# %% [markdown]
# How tall, and how far the surface is from the true one, in the poses of the scans.


# %%
def height(body):
    return float(np.ptp(np.asarray(body.vertices[:, 1])))


def apart(body, motion):
    found = [jc.pose_body(body, motion[number]).vertices for number in range(len(clouds))]
    return 1000 * np.mean(
        [np.linalg.norm(one - two.vertices, axis=1) for one, two in zip(found, posed, strict=True)]
    )


last = states[-1]
print(
    f"height: template {height(template):.2f} m, adapted {height(last.body):.2f} m, actor {height(actor):.2f} m"
)
print(
    f"vertices: {apart(states[0].body, states[0].motion):.0f} mm off after size, {apart(last.body, last.motion):.0f} mm in the end"
)

# %%
figure, plots = plt.subplots(1, 4, figsize=(8.0, 3.4))
bodies = (("template", template), ("its size", states[0].body), ("adapted", last.body), ("actor", actor))
for plot, (name, body) in zip(plots, bodies, strict=True):
    draw_surface(plot, np.asarray(body.vertices, float), np.asarray(body.faces), VIEW)
    frame(plot, np.array([-0.6, -0.9]), np.array([0.6, 1.0]), name)
plt.show()

# %%
figure, plot = plt.subplots(figsize=(6.0, 2.6))
plot.plot([value for _, value in last.history], marker="o")
plot.set_xticks(
    range(len(last.history)), [name for name, _ in last.history], rotation=30, ha="right", fontsize=8
)
plot.set(ylabel="pairs, mm", ylim=(0, None))
plt.show()
