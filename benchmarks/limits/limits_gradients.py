"""Check gradients of joint limits against central differences: `python -m benchmarks.limits_gradients`.

The signed distance of a learned surface in its chart, on the thickness of primitives, on their cut-off, inside
and far off; limits as an energy by the numbers of a pose; and the soft object's distance. Double precision.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks.report import finish, progress
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.retraction import retract
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.fit.linearise import linearise
from jaxcap.limits.primitives import STIFFNESS, signed_distance

#: step of the differences, and how near a kink they may straddle it
STEP = 1e-6


def surface_error(limits: jc.limits.SurfaceLimits, rng: np.random.Generator) -> float:
    """Compute the largest difference of slopes, which are about one."""
    worst = 0.0
    for surface in limits.surfaces:
        parent = None if surface.parent is None else surface.keys[len(surface.keys) // 2]
        primitives = surface.primitives(parent)
        value = jax.jit(lambda x, p=primitives: signed_distance(p, x))
        slope = jax.jit(jax.grad(value))
        chosen = rng.integers(0, len(primitives.centres), 60)
        away = rng.normal(size=(60, 3)) * (np.arange(3) < surface.chart.dimension)
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        cut = 2 / STIFFNESS * float(surface.unit)
        for edge in (-0.5 * float(surface.unit), 0.0, cut / 3, cut, 0.3):
            reach = np.asarray(primitives.thickness)[chosen, None] + edge
            for point in np.asarray(primitives.centres)[chosen] + reach * away:
                found = [(value(point + STEP * e) - value(point - STEP * e)) / (2 * STEP) for e in np.eye(3)]
                worst = max(
                    worst, float(np.abs(np.asarray(slope(jnp.asarray(point))) - np.array(found)).max())
                )
    return worst


def energy_error(energy: AbstractEnergy, body: jc.Body, pose: jc.Pose) -> float:
    """Compute the largest error of an energy's Jacobian, relative to its largest entry."""

    @eqx.filter_jit
    def residual(d):
        return energy.residual(jc.pose_body(body, retract(body.skeleton, pose, d)))

    _, jacobian = eqx.filter_jit(linearise)(energy, body, pose)
    numbers = np.eye(body.skeleton.num_dofs)
    found = np.stack([(residual(STEP * e) - residual(-STEP * e)) / (2 * STEP) for e in numbers], 1)
    return float(np.abs(np.asarray(jacobian) - found).max() / max(np.abs(found).max(), 1e-12))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    rng, body = np.random.default_rng(0), jc.human(resolution="low", joints="tracking")
    body = jax.tree.map(lambda x: x.astype(float) if eqx.is_inexact_array(x) else x, body)
    takes = walk_and_wave(body.skeleton, seconds=6.0)
    samples = jc.limits.gather_samples([(body.skeleton, takes)], "RightForeArm", "RightArm")
    assert samples.parent is not None
    limits = jc.limits.learn_limits(
        {"RightArm": samples.parent, "RightForeArm": samples}, voxel=np.radians(12), keyframe=np.radians(30)
    )
    figures = {"surface": surface_error(limits, rng), "limits": 0.0, "soft_object": 0.0}
    progress(f"surface: {figures['surface']:.2g}")
    soft = jc.energy.make_soft_object(body)
    poses = jc.body.sample_poses(body.skeleton, count=6, seed=9)
    for number in range(1, 6):
        pose = jax.tree.map(lambda leaf, n=number: leaf[n], poses)
        figures["limits"] = max(figures["limits"], energy_error(jc.JointLimits(limits), body, pose))
        points = jc.pose_body(body, pose).vertices[::20] + 0.05 * rng.normal(
            size=(len(body.vertices[::20]), 3)
        )
        term = jc.energy.SoftPoints(soft, points, jnp.ones(len(points)), jnp.asarray(0.1))
        figures["soft_object"] = max(figures["soft_object"], energy_error(term, body, pose))
    finish(
        "limits_gradients",
        figures,
        {"surface": ("<=", 1e-3), "limits": ("<=", 1e-3), "soft_object": ("<=", 1e-5)},
    )


if __name__ == "__main__":
    main()
