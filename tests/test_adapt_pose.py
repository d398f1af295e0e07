"""How the pose of one frame goes on: uphill for a while, back to the best, and damped where steps are too long."""

import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of

from jaxcap.adapt import pose as module
from jaxcap.adapt.pose import UPHILL, best_share, fit_pose
from jaxcap.body.pose import retract
from jaxcap.fit.correspond import make_scan


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


def steps_through(monkeypatch, offsets, scene, shares=None, **options):
    """What `fit_pose` makes of steps that lead to these distances from the true pose, and the dampings it asked for."""
    actor, prior, scan, _ = start_of(scene, 0.0)
    truth, asked, taken = scene[2][2], [], iter(offsets[1:])
    way = np.random.default_rng(1).normal(size=actor.skeleton.num_dofs)

    def at(offset):
        return retract(actor.skeleton, truth, jnp.asarray(offset * way))

    def improve(*arguments):
        asked.append(float(arguments[-1]))
        return at(next(taken)), jnp.asarray(1.0 if shares is None else shares[len(asked) - 1])

    monkeypatch.setattr(module, "_improve", improve)
    found = fit_pose(actor, scan, at(offsets[0]), prior, weight=0.0, **options)
    places = np.array([np.asarray(at(offset).rotations) for offset in offsets])
    off = np.abs(places - np.asarray(found.pose.rotations)).max((1, 2))
    return int(off.argmin()), asked


def test_more_steps_are_never_worse_than_fewer(scene):
    actor, prior, scan, start = start_of(scene, 0.15)
    values = [
        fit_pose(actor, scan, start, prior, weight=1e-8, steps=steps).data for steps in (1, 2, 4, 8, 12)
    ]
    assert (np.diff(values) <= 1e-15).all()
    assert values[-1] < 0.5 * values[0]


def test_steps_may_lead_uphill_and_the_best_is_kept(scene, monkeypatch):
    # over a hill of two to a better place, from which it only gets worse
    best, asked = steps_through(monkeypatch, [0.06, 0.1, 0.08, 0.02, 0.03, 0.05, 0.07, 0.001], scene, steps=7)
    assert best == 3
    assert len(asked) == 3 + UPHILL + 1
    # the hill is too long
    best, _ = steps_through(monkeypatch, [0.06, 0.1, 0.09, 0.08, 0.001], scene, steps=4)
    assert best == 0


def test_damping_grows_where_steps_are_too_long_and_falls_again(scene, monkeypatch):
    offsets = [0.1 * 0.8**n for n in range(7)]
    shares = [1.0, 0.1, 0.0, 0.5, 1.0, 1.5]
    _, asked = steps_through(monkeypatch, offsets, scene, shares, steps=6, damping=1e-3)
    np.testing.assert_allclose(asked, [1e-3, 1e-3, 1e-2, 1e-1, 1e-1, 1e-2], rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "share"),
    [([2.0, 1.0, 3.0], 1.0), ([np.nan, 4.0, 3.0], 0.0), ([np.inf, 1.0, np.nan], 1.0), ([np.nan] * 3, 0.0)],
)
def test_a_step_worth_no_number_is_never_taken(values, share):
    assert float(best_share(jnp.array([1.5, 1.0, 0.0]), jnp.array(values))) == share
