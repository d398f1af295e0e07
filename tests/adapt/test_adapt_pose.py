"""How the pose of one frame goes on: more steps are never worse than fewer."""

import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of

from jaxcap.adapt.objective import PoseTerms
from jaxcap.adapt.poses.fit_frame import fit_pose
from jaxcap.body.retraction import retract
from jaxcap.fit.correspondence.nearest_assignment import make_scan


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def start_of(scene, size: float):
    """The actor, a scan, and a pose that is off by so many radians and a tenth as many metres."""
    _, actor, poses, _ = scene
    task, way = task_of(scene), np.random.default_rng(1).normal(size=actor.skeleton.num_dofs)
    way[:3] *= 0.1
    return (
        actor,
        task.prior,
        make_scan(task.cloud(2)),
        retract(actor.skeleton, poses[2], jnp.asarray(size * way)),
    )


def test_more_steps_are_never_worse_than_fewer(scene):
    actor, prior, scan, start = start_of(scene, 0.15)
    values = [
        fit_pose(actor, scan, start, PoseTerms(prior, 1e-8), steps=steps).data for steps in (1, 2, 4, 8, 12)
    ]
    assert (np.diff(values) <= 1e-15).all()
    assert values[-1] < 0.5 * values[0]
