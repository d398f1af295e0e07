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
# # From optical markers to a skeleton and its motion
#
# Trajectories of markers, and nobody says which marker sits where. The page on [markers](../docs/markers.md) says how it works.

# %%
import tempfile
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.geometry import rotation
from jaxcap.report.plots import BLUE, RED, style_chart
from jaxcap.report.render import INK, distinct_colours, set_frame

# %% [markdown]
# A trunk with two arms, four markers on each segment, in random motion; a millimetre of noise, a tenth of the frames of some markers are missing,
# and in some frames two labels are exchanged. Files of your own come from `jc.read_markers("trial.c3d")`.

# %%
NAMES = ("trunk", "left_arm", "left_hand", "right_arm", "right_hand")
CENTRES = np.array([[0.0, 0, 0], [0.2, 0.3, 0], [0.5, 0.3, 0], [-0.2, 0.3, 0], [-0.5, 0.3, 0]])
FRAMES, RATE = 240, 60.0
rng = np.random.default_rng(3)
skeleton = jc.make_skeleton(NAMES, (-1, 0, 1, 0, 3), ["free"] + ["ball"] * 4, centres=CENTRES)
bones = np.repeat(np.arange(5), 4)
offsets = CENTRES[bones] + np.sign(CENTRES[bones, :1]) * [[0.15, 0, 0]] + 0.08 * rng.normal(size=(20, 3))
labels = [f"{NAMES[bone]}{number}" for number, bone in enumerate(bones)]
subject = jc.markers.make_subject(skeleton, bones, offsets, labels)

time = np.arange(FRAMES) / RATE
phases, speeds = rng.uniform(0, 6.28, (5, 3)), rng.uniform(1.0, 3.0, (5, 3))
turns = 0.6 * np.sin(phases + speeds * time[:, None, None])
shifts = np.zeros((FRAMES, 5, 3))
shifts[:, 0, 0] = 0.3 * time
poses = jc.Pose(jnp.asarray(shifts), rotation.exp(jnp.asarray(turns)), jnp.ones(FRAMES))
places = np.array(eqx.filter_jit(jax.vmap(jc.markers.marker_positions, (None, 0)))(subject, poses))
truth = places.copy()
places += 0.001 * rng.normal(size=places.shape)
for marker in rng.choice(20, 6, replace=False):
    begin = rng.integers(FRAMES - 24)
    places[begin : begin + 24, marker] = np.nan
for number in range(0, FRAMES, 40):
    one, other = rng.choice(20, 2, replace=False)
    places[number, [one, other]] = places[number, [other, one]]
order = rng.permutation(20)
frames = jc.make_markers(places[:, order], [f"m{number:02d}" for number in range(20)], rate=RATE)
frames.positions.shape, f"{float(frames.visible.mean()):.1%} seen"

# %%
seen = np.asarray(frames.visible)
figure, plot = plt.subplots(figsize=(7.0, 3.2))
for marker in range(seen.shape[1]):
    edges = np.flatnonzero(np.diff(np.pad(seen[:, marker].astype(int), 1)))
    plot.hlines([marker] * (len(edges) // 2), edges[::2], edges[1::2] - 1, color=BLUE, linewidth=5)
    for begin, end in zip(edges[1:-1:2], edges[2::2], strict=True):
        plot.hlines(marker, begin, end - 1, color=RED, linewidth=1.5)
plot.set_yticks(range(0, 20, 5), [frames.labels[marker] for marker in range(0, 20, 5)])
style_chart(plot, "Six markers are missing for 24 frames each (thin and red)", "frame")
plt.show()

# %% [markdown]
# ## Limb by limb
#
# Markers that keep their distances are a segment; segments whose markers turn about a common point have a joint there; the surest joints make
# the tree. It is told what was mended.

# %%
found = jc.markers.fit_local(frames)
print(*found.messages, sep="\n")
print(f"{len(found.segments.members)} segments, {found.skeleton.num_joints} bones: {found.skeleton.kinds}")

# %% [markdown]
# ## All together
#
# Poses of chosen frames, centres of joints and places of markers, fitted at once.

# %%
calibrated = jc.markers.calibrate(found.markers, found.subject)
print(*(calibrated.messages or ("the frames tell all of it",)), sep="\n")
centres = np.asarray(calibrated.subject.skeleton.centres)
lengths = sorted(
    float(np.linalg.norm(centres[joint] - centres[parent]))
    for joint, parent in enumerate(calibrated.subject.skeleton.parents)
    if parent > 0
)
print("bones between joints:", [f"{1000 * length:.1f} mm" for length in lengths], "where 300 is true")

# %% [markdown]
# ## Every frame, and gaps filled

# %%
solution = jc.markers.solve_markers(calibrated.subject, frames)
whole = jc.markers.fill_gaps(calibrated.subject, solution.motion, frames, lost=solution.lost)
hidden = ~np.asarray(frames.visible)
off = 1000 * np.linalg.norm(np.asarray(whole.positions) - truth[:, order], axis=2)
print(f"{len(solution.lost)} frames solved, {int(solution.lost.sum())} lost")
print(f"markers in gaps come back within {np.median(off[hidden]):.1f} mm at the median")

# %%
figure, plots = plt.subplots(1, 3, figsize=(9.0, 3.0))
figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.9, wspace=0.0)
joints = np.asarray(jc.markers.joint_frames(calibrated.subject.skeleton, solution.motion).positions)
parents = calibrated.subject.skeleton.parents
bones = np.asarray(calibrated.subject.bones)
colours = distinct_colours(len(parents))
for plot, number in zip(plots, (20, 110, 210), strict=True):
    middle = joints[number].mean(0)
    here, markers_here = joints[number] - middle, np.asarray(whole.positions)[number] - middle
    for marker, bone in enumerate(bones):
        line = np.stack([here[bone], markers_here[marker]])
        plot.plot(*line[:, :2].T, color=colours[bone], lw=0.8, alpha=0.6, zorder=1)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            plot.plot(*here[[parent, joint], :2].T, color=INK, lw=3.0, solid_capstyle="round", zorder=2)
    found_again = hidden[number]
    plot.scatter(*markers_here[:, :2].T, s=34, c=colours[bones], zorder=3)
    plot.scatter(
        *markers_here[found_again, :2].T, s=95, facecolors="none", edgecolors=RED, linewidths=1.4, zorder=4
    )
    plot.scatter(*here[:, :2].T, s=30, c="white", edgecolors=INK, linewidths=1.2, zorder=5)
    count = int(found_again.sum())
    set_frame(
        plot, np.array([-0.9, -0.75]), np.array([0.9, 0.75]),
        f"frame {number}" + (f": ring, {count} filled" if count else ""),
    )  # fmt: skip
plt.show()

# %% [markdown]
# ## Frame by frame, as they come

# %%
streamer, state = jc.markers.make_streamer(calibrated.subject)
for number in range(20):
    state, pose = jc.markers.stream_frame(streamer, state, places[number, order])
folder = Path(tempfile.mkdtemp())
jc.io.save_subject(folder / "subject.npz", calibrated.subject)
jc.write_bvh(folder / "trial.bvh", calibrated.subject.skeleton, solution.motion)
jc.write_markers(folder / "filled.trc", whole)
sorted(path.name for path in folder.iterdir())
