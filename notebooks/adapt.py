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
# # A template becomes the actor
#
# Noisy, partial scans that are not registered to anything; the template's size, build, joints and surface change until they are those of the
# person who was scanned. The page on [adaptation](../docs/adaptation.md) says how it works. Here are six scans and a few short rounds, to be
# done in a minute; a result to work with takes forty frames and all rounds.

# %%
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.report.plots import (
    BLUE,
    distance_bar,
    draw_person,
    draw_scan,
    frame_together,
    label_point,
    style_chart,
)

# %% [markdown]
# The actor: a woman, small and heavier than the template, seen by four cameras with 3 mm of noise.

# %%
actor = jc.human(sex="female", age=45, weight=0.8, height=1.6, resolution="low", joints="tracking")
motion = walk_and_wave(actor.skeleton, seconds=2.0)
chosen = (0, 12, 24, 36, 48, 59)
posed = [jc.pose_body(actor, motion[number]) for number in chosen]
cameras = jc.geometry.ring_of_cameras(
    4, 360, distance=2.5, height=0.6, target=[0.0, 0.0, 0.0], resolution=(160, 160)
)
scanner = jc.scanner.Scanner(noise=0.003, points=3000)
scans = [
    jc.scanner.scan_frame(
        scanner, cameras, np.asarray(one.vertices, float), np.asarray(actor.faces), frame=number
    )
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
    settings=jc.adapt.AdaptSettings(num_frames=4, proportion_rounds=3, rounds=(2,), temporal_weight=0.0),
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
bodies = {"the template": template, "its size": states[0].body, "adapted": last.body, "the actor": actor}
figure, plots = plt.subplots(1, 4, figsize=(9.0, 4.0))
figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.92, wspace=0.0)
seen = []
for plot, body in zip(plots, bodies.values(), strict=True):
    # all on one floor
    surface = np.asarray(body.vertices, float) - [0.0, float(body.vertices[:, 1].min()), 0.0]
    seen.append(draw_person(plot, surface, np.asarray(body.faces)))
frame_together(plots, seen, list(bodies))
plt.show()

# %% [markdown]
# The scans on the bodies: their distance after the first stage, and in the end.

# %%
figure, plots = plt.subplots(1, 4, figsize=(9.0, 4.4))
figure.subplots_adjust(left=0.0, right=1.0, top=0.92, wspace=0.0)
seen, titles = [], []
for column, (name, state, number) in enumerate(
    (name, state, number) for number in (0, 3) for name, state in (("its size", states[0]), ("adapted", last))
):
    surface = np.asarray(jc.pose_body(state.body, state.motion[number]).vertices, float)
    seen.append(draw_person(plots[column], surface, np.asarray(state.body.faces)))
    draw_scan(plots[column], scans[number].points, surface, np.asarray(state.body.faces), far=0.03)
    titles.append(f"{name}, scan {number}")
frame_together(plots, seen, titles)
distance_bar(figure, 0.03)
plt.show()

# %%
names, values = zip(*last.history, strict=True)
figure, plot = plt.subplots(figsize=(7.0, 3.2))
plot.plot(values, color=BLUE, marker="o", ms=4)
plot.set_xticks(range(len(names)), names, rotation=30, ha="right")
plot.set_ylim(0, 1.15 * max(values))
for stage in (0, len(values) - 1):
    label_point(plot, f"{values[stage]:.1f} mm", (stage, values[stage]), BLUE, xytext=(-2, 8))
style_chart(plot, "Proportions bring most; new pairs may cost a little for once", y_label="pairs, mm")
plt.show()
