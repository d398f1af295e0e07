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
# # Batches on many devices
#
# A fit is a pure function of arrays, so many of them go side by side: on one device, or spread over several. A computer's processor can
# pose as several devices, which is how this is tried out without any; the flag has to be set before JAX starts.

# %%
import os

os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=4"
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import jaxcap as jc
from jaxcap.geometry.mesh import sample_surface
from jaxcap.report.plots import (
    AMBER,
    BLUE,
    GREEN,
    QUIET,
    RED,
    distance_bar,
    draw_person,
    draw_scan,
    frame_together,
    label_point,
    style_chart,
)

jax.devices()

# %% [markdown]
# Sixteen poses of the embedded human, each with a cloud of 800 points with 3 mm of noise, and starts that are off by
# about a tenth of a metre or radian in every number.

# %%
BATCH = 16
body = jc.human(resolution=500, joints="tracking")
skeleton = body.skeleton
truth = jc.body.sample_poses(skeleton, count=BATCH)
rng = np.random.default_rng(0)


def one_of(poses, number):
    return jax.tree.map(lambda leaf: leaf[number], poses)


def cloud_of(number):
    vertices = jc.pose_body(body, one_of(truth, number)).vertices
    points, normals = sample_surface(np.asarray(vertices, float), np.asarray(body.faces), 800, rng)
    return jc.make_cloud(points + 0.003 * rng.normal(size=points.shape), normals)


clouds = jc.observe.stack_clouds([cloud_of(number) for number in range(BATCH)])
off = jnp.asarray(0.1 * rng.normal(size=(BATCH, skeleton.num_dofs)), jnp.float32)
starts = jax.vmap(lambda pose, d: jc.retract(skeleton, pose, d))(truth, off)
clouds.points.shape, starts.rotations.shape

# %% [markdown]
# ## On one device
#
# `fit_batch` takes clouds `(B, N, 3)`, or sequences `(B, F, N, 3)`, with a start for each. It goes through them one after the other, which
# is fastest on a processor; `batch_size` says how many go side by side, for accelerators.

# %%
tracker = jc.make_tracker(body, iterations=20, max_iterations=20)
alone, statistics = jax.block_until_ready(jc.fit.fit_batch(tracker, starts, clouds))


@jax.jit
def joints_of(poses):
    return jax.lax.map(lambda pose: jc.pose_body(body, pose).joints, poses)


def joint_errors(some):
    """Return the mean error of the joints of each pose, millimetres."""
    return 1000 * np.linalg.norm(joints_of(some) - joints_of(truth), axis=-1).mean(1)


print(
    f"joints are {joint_errors(starts).mean():.0f} mm off to begin with, {np.median(joint_errors(alone)):.1f} mm at the median in the end"
)

# %% [markdown]
# ## On four
#
# Spread the first axis of starts and clouds over a mesh of devices; the tracker, with its body, is the same on all. Each device then
# goes through its own quarter: `shard_map` says so, and no number crosses from one to another.

# %%
devices = Mesh(np.array(jax.devices()), ("batch",))
split = NamedSharding(devices, PartitionSpec("batch"))
shared_starts, shared_clouds = jax.device_put((starts, clouds), split)
for shard in shared_clouds.points.addressable_shards:
    print(shard.device, "has clouds", f"{shard.index[0].start} to {shard.index[0].stop - 1}")

# %%
spread = jax.jit(
    jax.shard_map(
        lambda starts, clouds: jc.fit.fit_batch(tracker, starts, clouds),
        mesh=devices,
        in_specs=PartitionSpec("batch"),
        out_specs=PartitionSpec("batch"),
        check_vma=False,
    )
)
together, _ = jax.block_until_ready(spread(shared_starts, shared_clouds))
print(together.rotations.sharding)
differences = jnp.abs(together.rotations - alone.rotations).max((1, 2))
print(f"poses that agree to 1e-5: {int((differences < 1e-5).sum())} of {BATCH}")
print(
    f"mean error of the joints: {joint_errors(alone).mean():.2f} mm alone, {joint_errors(together).mean():.2f} mm together"
)

# %% [markdown]
# The results are the same but for rounding, which differs between two compiled programs. Where it changes which vertex is
# nearest to a point, a pose may converge to another minimum, a few millimetres away. Four devices that are one processor share
# its cores, so nothing is gained here beyond cores that were idle; on a machine with four accelerators a batch takes the time
# of its quarter.

# %% [markdown]
# Which quarter a device had, and how far joints were off before and after.

# %%
number, before, after = np.arange(BATCH), joint_errors(starts), joint_errors(together)
colours = np.repeat([BLUE, GREEN, AMBER, RED], BATCH // 4)
figure, plot = plt.subplots(figsize=(7.0, 3.2))
plot.vlines(number, after, before, color="#dde3ea", linewidth=5)
plot.scatter(number, before, s=26, color=QUIET, zorder=3)
plot.scatter(number, after, s=34, color=colours, zorder=3)
plot.set(yscale="log", xticks=number, ylim=(5, 1000))
for device in range(4):
    first = device * BATCH // 4
    label_point(
        plot,
        f"device {device}",
        (first, 0.92),
        colours[first],
        xycoords=("data", "axes fraction"),
        xytext=(-4, 0),
    )
label_point(plot, "start", (0, before[0]), QUIET, xytext=(-6, 7))
style_chart(
    plot,
    "From decimetres to a centimetre on each device; one of sixteen stays wrong",
    "cloud",
    "mean error of joints, mm",
)
plt.show()

# %%
chosen = range(0, BATCH, BATCH // 4)
figure, plots = plt.subplots(1, 4, figsize=(9.0, 3.4))
figure.subplots_adjust(left=0.0, right=1.0, top=0.92, wspace=0.0)
seen = []
for plot, number in zip(plots, chosen, strict=True):
    surface = np.asarray(jc.pose_body(body, one_of(together, number)).vertices, float)
    seen.append(draw_person(plot, surface, np.asarray(body.faces)))
    draw_scan(plot, np.asarray(clouds.points[number], float), surface, np.asarray(body.faces))
frame_together(plots, seen, [f"cloud {number}, device {device}" for device, number in enumerate(chosen)])
distance_bar(figure)
plt.show()

# %% [markdown]
# ## Derivatives of a batch
#
# `scan_track` and `fit_batch` are differentiable as they stand, and so is `solve` under `jax.vmap`: here the gradient of sixteen solutions by
# a weight that they share.

# %%
hand = skeleton.index("RightHand")
goals = joints_of(truth)


def reach(weight, goal, start):
    pull = jc.energy.joint_landmarks(goal, jnp.eye(skeleton.num_joints)[hand])
    near = jc.RestPrior(jnp.ones((skeleton.num_joints, 3)))
    solution = jc.solve(weight * pull + near, body, start, max_steps=12)
    return jnp.sum((jc.pose_body(body, solution.pose).joints[hand] - goal[hand]) ** 2)


slopes = jax.jit(jax.vmap(jax.grad(reach), (None, 0, 0)))(100.0, goals, starts)
print("every solution comes nearer as the weight grows:", bool((slopes < 0).all()))
