"""`fit_batch` on several devices, as which the processor poses in a process of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
PROGRAM = """
import dataclasses, json
import jax, jax.numpy as jnp, numpy as np
import jaxcap as jc

body = jc.human(resolution=500, joints="tracking")
tracker = jc.make_tracker(body, iterations=1)
truth = jc.body.sample_poses(body.skeleton, count=3)
clouds = []
for number in range(3):
    posed = jc.pose_body(body, jax.tree.map(lambda leaf: leaf[number], truth))
    clouds.append(jc.make_cloud(posed.vertices + 0.002 * number, posed.normals))
clouds = jc.observe.stack_clouds(clouds)


def total(points, devices):
    moved = dataclasses.replace(clouds, points=points)
    poses, statistics = jc.fit.fit_batch(tracker, truth, moved, sigma=0.05, devices=devices)
    return jnp.sum(poses.translations[:, 0] ** 2) + jnp.sum(statistics.mean_distance), poses


def found(devices):
    (value, poses), gradient = jax.value_and_grad(total, has_aux=True)(clouds.points, devices)
    return np.asarray(poses.rotations), np.asarray(gradient)


alone, divided = found(None), found(jax.local_devices())
print(json.dumps({
    "devices": len(jax.local_devices()),
    "poses": float(abs(alone[0] - divided[0]).max()),
    "moved": float(abs(alone[0] - np.asarray(truth.rotations)).max()),
    "gradient": float(abs(alone[1] - divided[1]).max()),
    "size": float(abs(alone[1]).max()),
}))
"""


@pytest.mark.slow
def test_devices_give_what_one_gives():
    """Three clouds on two devices: the same poses and the same derivatives by the points."""
    env = os.environ | {
        "PYTHONPATH": str(CHECKOUT),
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=env, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr[-2000:]
    line = json.loads(done.stdout.splitlines()[-1])
    assert line["devices"] == 2
    assert line["poses"] < 1e-5
    # something was fitted, and depends on the points
    assert line["moved"] > 1e-4
    assert line["size"] > 1e-4
    assert line["gradient"] < 1e-3 * line["size"]
