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
# # Track a body in clouds
#
# Points that depth cameras saw, in no order and with noise, become poses of a skeleton. The page on
# [tracking](../docs/tracking.md) says how it works.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.metrics import joint_errors
from jaxcap.report.plots import (
    AMBER,
    BLUE,
    PERSON,
    RED,
    distance_bar,
    draw_person,
    draw_scan,
    frame_together,
    label_point,
    style_chart,
)
from jaxcap.report.render import draw_shadow

# %% [markdown]
# A person walks on the spot and waves, and four cameras see it: each measures depths with 4 mm of noise, a twentieth of the
# pixels at edges fly, and what none of them sees is missing. With scans of your own this is
# `jc.read_clouds("scans/*.ply", unit="mm")`.

# %%
truth = jc.human(resolution="medium")
performance = walk_and_wave(truth.skeleton, seconds=1.0)
posed = [jc.pose_body(truth, performance[number]) for number in range(performance.num_frames)]
cameras = jc.geometry.ring_of_cameras(
    4, 360, distance=2.5, height=0.6, target=[0.0, 0.1, 0.0], resolution=(160, 160)
)
scanner = jc.scanner.Scanner(noise=0.004, flying=0.05, points=3000)
scans = [
    jc.scanner.scan_frame(
        scanner, cameras, np.asarray(body.vertices, float), np.asarray(truth.faces), frame=number
    )
    for number, body in enumerate(posed)
]
clouds = [jc.make_cloud(scan.points, scan.normals) for scan in scans]
len(clouds), clouds[0].points.shape

# %% [markdown]
# The body that is fitted may be another mesh than what was scanned; here it has 1,500 vertices, and no fingers that move.

# %%
body = jc.human(resolution="low", joints="tracking")
motion = jc.track(body, clouds)
motion

# %% [markdown]
# What came in, near points dark, and what came out under it: each point has the colour of its distance to the fitted surface.

# %%
faces, shown = np.asarray(body.faces), (0, 14, 28)
figure, plots = plt.subplots(2, 3, figsize=(9.0, 7.4))
figure.subplots_adjust(left=0.0, right=1.0, top=0.95, wspace=0.0, hspace=0.06)
seen = []
for column, number in enumerate(shown):
    above, below = plots[:, column]
    surface = np.asarray(jc.pose_body(body, motion[number]).vertices, float)
    seen.append(draw_shadow(above, surface, faces, PERSON))
    points = scans[number].points @ PERSON.T
    points = points[np.argsort(points[:, 2])]
    above.scatter(*points[:, :2].T, c=points[:, 2], cmap="Blues", vmin=-0.6, s=2.2, linewidths=0, zorder=2)
    seen.append(draw_person(below, surface, faces))
    draw_scan(below, scans[number].points, surface, faces)
titles = [f"the scan of frame {number}" for number in shown] + [
    f"tracked, frame {number}" for number in shown
]
frame_together(plots.ravel(), seen, titles)
distance_bar(figure)
plt.show()

# %% [markdown]
# Where the truth is known, errors are those of joint centres.

# %%
found = [jc.pose_body(body, motion[number]).joints for number in range(motion.num_frames)]
errors = 1000 * joint_errors(np.array(found), np.array([one.joints for one in posed]))
print(f"mean {errors.mean():.1f} mm, 99 % of joints within {np.quantile(errors, 0.99):.1f} mm")

# %% [markdown]
# ## A stream, and a frame that is none
#
# `track_frames` gives a frame as soon as it is done, with how well it is explained. Here one cloud is replaced by noise:
# it is told as lost, and the next one is found again.

# %%
rng = np.random.default_rng(0)
broken = list(clouds[:14])
broken[9] = jc.make_cloud(rng.uniform(-1, 1, size=(3000, 3)), rng.normal(size=(3000, 3)))
tracker = jc.make_tracker(body)
stream = list(jc.fit.track_frames(tracker, broken))
[number for number, tracked in enumerate(stream) if tracked.lost]

# %%
distances = [float(tracked.statistics.mean_distance) * 1000 for tracked in stream]
outliers = [float(tracked.statistics.outlier_share) * 100 for tracked in stream]
figure, plot = plt.subplots(figsize=(7.0, 3.0))
for lost in (number for number, tracked in enumerate(stream) if tracked.lost):
    plot.axvspan(lost - 0.5, lost + 0.5, color="#fbe3e6", linewidth=0)
    label_point(plot, "lost: noise, no scan", (lost + 0.5, max(distances)), RED, xytext=(5, -8))
plot.plot(distances, color=BLUE, marker="o", ms=4)
plot.plot(outliers, color=AMBER, marker="o", ms=4)
label_point(plot, "mean distance, mm", (0, distances[0]), BLUE)
label_point(plot, "outliers, %", (0, outliers[0]), AMBER)
plot.set_yscale("log")
style_chart(plot, "One frame of noise stands out and harms no other", "frame")
plt.show()

# %% [markdown]
# ## To files

# %%
folder = Path(tempfile.mkdtemp())
jc.write_bvh(folder / "motion.bvh", body.skeleton, motion)
jc.save_motion(folder / "motion.npz", motion, body.skeleton)
sorted(path.name for path in folder.iterdir())
