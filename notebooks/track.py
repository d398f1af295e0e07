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
from jaxcap.demo.performance import walk_and_wave
from jaxcap.metrics import joint_errors
from jaxcap.report.render import draw_surface, frame, turned

VIEW = turned(np.eye(3), 25)

# %% [markdown]
# A person walks on the spot and waves, and four cameras see it: each measures depths with 4 mm of noise, a twentieth of the
# pixels at edges fly, and what none of them sees is missing. With scans of your own this is
# `jc.read_clouds("scans/*.ply", unit="mm")`.

# %%
truth = jc.human(resolution="medium")
performance = walk_and_wave(truth.skeleton, seconds=1.0)
posed = [jc.pose_body(truth, performance[number]) for number in range(performance.num_frames)]
cameras = jc.ring_of_cameras(4, 360, distance=2.5, height=0.6, target=[0.0, 0.1, 0.0], resolution=(160, 160))
scanner = jc.Scanner(noise=0.004, flying=0.05, points=3000)
scans = [
    jc.scan_frame(scanner, cameras, np.asarray(body.vertices, float), np.asarray(truth.faces), frame=number)
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
# What came in, and what came out.

# %%
figure, plots = plt.subplots(1, 6, figsize=(9.0, 3.0))
for column, number in enumerate((0, 14, 28)):
    seen = scans[number].points @ VIEW.T
    plots[2 * column].scatter(*seen[np.argsort(seen[:, 2])].T[:2], s=0.6, c="#1f4e79", linewidths=0)
    surface = np.asarray(jc.pose_body(body, motion[number]).vertices, float)
    draw_surface(plots[2 * column + 1], surface, np.asarray(body.faces), VIEW)
    for plot in plots[2 * column : 2 * column + 2]:
        frame(plot, np.array([-0.75, -0.85]), np.array([0.75, 1.1]), f"frame {number}")
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
stream = list(jc.track_frames(tracker, broken))
[number for number, tracked in enumerate(stream) if tracked.lost]

# %%
figure, plot = plt.subplots(figsize=(6.0, 2.4))
plot.plot(
    [float(tracked.statistics.mean_distance) * 1000 for tracked in stream],
    marker="o",
    label="mean distance, mm",
)
plot.plot(
    [float(tracked.statistics.outlier_share) * 100 for tracked in stream], marker="s", label="outliers, %"
)
plot.set(xlabel="frame", yscale="log")
plot.legend(frameon=False)
plt.show()

# %% [markdown]
# ## To files

# %%
folder = Path(tempfile.mkdtemp())
jc.write_bvh(folder / "motion.bvh", body.skeleton, motion)
jc.save_motion(folder / "motion.npz", motion, body.skeleton)
sorted(path.name for path in folder.iterdir())
