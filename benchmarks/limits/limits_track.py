"""Measure the benefit of learned joint limits in tracking: `python -m benchmarks.limits_track`.

The embedded human performs five takes of CMU's subject 02, seen from the front of its pelvis by a
simulated stereo camera: 300 points of the right arm at most, 15 mm of noise along each
axis, a fifth of them missing, depth in steps of 20 mm. A soft object follows, each frame from the one
before, by as many Gauss-Newton steps without limits, with limits as an energy, and with limits before
all else (strict priorities). The rest of the body is known. Limits of shoulder, elbow and hand, each
coupled to the joint above, are learned from all takes of subjects 01 and 02 that are not tracked.

A frame is bad where the twist of shoulder or elbow is off by more than 30 degrees. For comparison the
same without limits and with the tracker's preference for rest (`RestPrior`), which is no limit.

Then twelve real frames of a depth camera: poses found with limits, all of which must be valid.
"""

import argparse
import dataclasses
import os
import time
from pathlib import Path
from typing import NamedTuple

# threads of BLAS and those of XLA wait for each other, and matrices of a pose are small
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcap as jc
from benchmarks._scenes import human_motion, shared_folder, takes_of
from benchmarks.limits._depth import depth_frames, fit_frames
from benchmarks.limits._stereo import ARM, STEREO, ArmFrames, simulate_arm, twists
from benchmarks.report import finish, progress
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.energy.data.soft_object import SoftObject, SoftPoints, make_soft_object
from jaxcap.fit.linearise import linearise
from jaxcap.fit.solvers.gauss_newton import damped_step
from jaxcap.fit.strict_priorities import priority_step
from jaxcap.limits.implicit_surface import SurfaceLimits
from jaxcap.limits.learning.learn_limits import learn_limits
from jaxcap.limits.learning.samples import gather_samples

TAKES = ("02_05", "02_07", "02_08", "02_09", "02_10")
#: degrees of twist beyond which a frame is bad
MAX_TWIST_ERROR = 30.0
#: joints whose twists are judged
SCORED_JOINTS = ARM[:2]
#: Gauss-Newton steps on a frame
STEPS = 4
#: deviation of points, and the distance at which they lose their pull, metres
DEVIATION, ROBUST = 0.015, 0.1
#: radians that a joint may turn from one frame to the next, and that it is allowed beyond its limits
MAX_FRAME_ROTATION, LIMIT_DEVIATION = 0.3, 0.1
#: constant on the diagonal of the normal equations
DAMPING = 1e-3
#: shoulders with elbows and hips with knees, both sides, for the depth frames
LIMITED_JOINTS = tuple(
    (side + joint, None if parent is None else side + parent)
    for side in ("Left", "Right")
    for joint, parent in (("Arm", None), ("ForeArm", "Arm"), ("UpLeg", None), ("Leg", "UpLeg"))
)


class Method(eqx.Module):
    """A method that fits a frame."""

    #: an energy among others, or before all else where steps are strict
    limits: SurfaceLimits | None = None
    strict: bool = eqx.field(static=True, default=False)
    #: deviations of joints from rest, where these are to hold it
    rest: Float[Array, "J 3"] | None = None

    def fit(self, body: jc.Body, data: jc.AbstractEnergy, pose: jc.Pose) -> jc.Pose:
        if self.rest is not None:
            data = data + jc.RestPrior(self.rest)
        limits = None if self.limits is None else jc.JointLimits(self.limits)
        if self.strict:
            groups = (data,) if limits is None else (limits, data)
            return jax.lax.fori_loop(0, STEPS, lambda _, pose: priority_step(groups, body, pose), pose)
        energy = data if limits is None else data + (1 / LIMIT_DEVIATION**2) * limits
        return jax.lax.fori_loop(0, STEPS, lambda _, pose: gauss_newton_step(energy, body, pose), pose)


class Outcome(NamedTuple):
    """The result of a method: F frames of the arm's joints."""

    rotations: Float[np.ndarray, "F 3 4"]
    #: of shoulder and elbow, degrees
    twists: Float[np.ndarray, "F 2"]
    #: distances of elbow and wrist from where they are, millimetres
    joints: Float[np.ndarray, "F 2"]
    milliseconds: float

    @property
    def is_bad(self) -> np.ndarray:
        return np.any(self.twists > MAX_TWIST_ERROR, axis=1)


def gauss_newton_step(energy: jc.AbstractEnergy, body: jc.Body, pose: jc.Pose) -> jc.Pose:
    residual, jacobian = linearise(energy, body, pose)
    damping = jnp.full(jacobian.shape[1], DAMPING, jacobian.dtype)
    step, solved = damped_step(residual, jacobian, damping)
    return jc.retract(body.skeleton, pose, jnp.where(solved, step, 0.0))


def arm_body(body: jc.Body) -> jc.Body:
    """Fix all joints of a body but those of the arm."""
    kinds = (
        kind if name in ARM else "fixed"
        for name, kind in zip(body.skeleton.names, body.skeleton.kinds, strict=True)
    )
    skeleton = dataclasses.replace(body.skeleton, kinds=tuple(kinds))
    return eqx.tree_at(lambda body: body.skeleton, body, skeleton)


@eqx.filter_jit
def track_arm(contender: Method, body: jc.Body, soft: SoftObject, seen: ArmFrames) -> Float[Array, "F 3 4"]:
    """Track the rotations of the arm's joints; the first frame of a motion starts at the true pose."""
    arm = jnp.array([body.skeleton.index(name) for name in ARM])
    free = jnp.full(body.skeleton.num_dofs, MAX_FRAME_ROTATION, seen.truth.rotations.dtype)

    def frame(rotations, now):
        truth, points, weights, first = now
        before = jnp.where(first, truth.rotations[arm], rotations)
        pose = jc.Pose(truth.translations, truth.rotations.at[arm].set(before), truth.scale)
        fit = SoftPoints(soft, points, weights, jnp.asarray(ROBUST, points.dtype))
        data = (1 / DEVIATION**2) * fit + jc.energy.PosePrior(pose, free)
        found = contender.fit(body, data, pose).rotations[arm]
        return found, found

    start = seen.truth.rotations[0, arm]
    return jax.lax.scan(frame, start, tuple(seen))[1]


def compare(
    contenders: dict[str, Method], body: jc.Body, seen: ArmFrames, repeats: int
) -> dict[str, Outcome]:
    """Run all methods alternately on the same data; seconds are medians without the first round."""
    skeleton, soft = body.skeleton, make_soft_object(body)
    moving, taken = arm_body(body), {name: [] for name in contenders}
    on_device = jax.tree.map(lambda leaf: jnp.asarray(leaf), seen)
    found = {}
    for turn in range(repeats + 1):
        for name, contender in contenders.items():
            start = time.perf_counter()
            found[name] = np.asarray(track_arm(contender, moving, soft, on_device))
            taken[name].append(time.perf_counter() - start)
        progress(f"round {turn}: " + ", ".join(f"{name} {t[-1]:.1f} s" for name, t in taken.items()))
    arm = [skeleton.index(name) for name in ARM]
    truth = np.asarray(seen.truth.rotations[:, arm])
    true_places = _places(body, seen.truth)
    outcomes = {}
    for name, rotations in found.items():
        twist = [twists(skeleton, j, truth[:, i], rotations[:, i]) for i, j in enumerate(SCORED_JOINTS)]
        places = _places(body, with_arm(skeleton, seen.truth, rotations))
        apart = 1000 * np.linalg.norm(places - true_places, axis=-1)[:, arm[1:]]
        median = 1000 * float(np.median(taken[name][1:] or taken[name])) / len(truth)
        outcomes[name] = Outcome(rotations, np.stack(twist, 1), apart, median)
    return outcomes


def with_arm(skeleton: jc.Skeleton, poses: jc.Pose, rotations: Float[np.ndarray, "F 3 4"]) -> jc.Pose:
    """Replace the rotations of the arm's joints in stacked poses."""
    arm = jnp.array([skeleton.index(name) for name in ARM])
    return jc.Pose(poses.translations, poses.rotations.at[:, arm].set(rotations), poses.scale)


@eqx.filter_jit
def _joints(body: jc.Body, poses: jc.Pose) -> Float[Array, "F J 3"]:
    return jax.lax.map(lambda pose: jc.pose_body(body, pose).joints, poses)


def _places(body: jc.Body, poses: jc.Pose) -> np.ndarray:
    return np.asarray(_joints(body, poses), float)


def learn_from(shared: Path, takes: list[str], body: jc.Body, pairs) -> SurfaceLimits:
    """Learn limits from takes on the human's skeleton, with each joint coupled to its parent in the pair."""
    motions = [(body.skeleton, human_motion(shared, take, body)) for take in takes]
    limits = learn_limits(
        {joint: gather_samples(motions, joint, parent, takes) for joint, parent in pairs}, held_out="blocks"
    )
    for surface in limits.surfaces:
        progress(
            f"{surface.joint}: {surface.chart.kind}, {surface.centres.shape[1]} primitives at "
            f"{len(surface.centres)} keyframes, voxels from {np.degrees(4 * float(surface.unit)):.2g} degrees"
        )
    return limits


def make_contenders(body: jc.Body, limits: SurfaceLimits) -> dict[str, Method]:
    rest = jnp.asarray(rest_deviations(body.skeleton), body.vertices.dtype)
    return {
        "none": Method(),
        "energy": Method(limits),
        "priorities": Method(limits, strict=True),
        "none_strict": Method(strict=True),
        "rest_prior": Method(rest=rest),
    }


def arm_pairs() -> tuple[tuple[str, str | None], ...]:
    return tuple(zip(ARM, (None, *ARM[:-1]), strict=True))


def tracking(
    shared: Path, takes: tuple[str, ...], frames: int | None, every: int, repeats: int
) -> dict[str, float]:
    body = jc.human(resolution="low", joints="tracking")
    learned = [take for take in takes_of(shared, "01") + takes_of(shared, "02") if take not in takes]
    progress(f"learned from {', '.join(learned)}; tracked {', '.join(takes)}")
    limits = learn_from(shared, learned, body, arm_pairs())
    seen = simulate_arm(shared, takes, body, frames, every)
    progress(f"{len(seen.first)} frames with {np.median(seen.weights.sum(1)):.0f} points")
    outcomes = compare(make_contenders(body, limits), body, seen, repeats)
    figures: dict[str, float] = {"frames": len(seen.first)}
    number = np.cumsum(seen.first) - 1
    for name, outcome in outcomes.items():
        shares = [100 * outcome.is_bad[number == k].mean() for k in range(len(takes))]
        by_take = ", ".join(f"{take} {share:.1f} %" for take, share in zip(takes, shares, strict=True))
        progress(
            f"{name}: {100 * outcome.is_bad.mean():.2f} % bad ({by_take}), {outcome.milliseconds:.2f} ms"
        )
        figures[f"bad_percent_{name}"] = 100 * float(outcome.is_bad.mean())
        for k, joint in enumerate(("shoulder", "elbow")):
            figures[f"bad_{joint}_percent_{name}"] = 100 * float(
                (outcome.twists[:, k] > MAX_TWIST_ERROR).mean()
            )
            figures[f"twist_{joint}_degrees_{name}"] = float(outcome.twists[:, k].mean())
        figures[f"elbow_mm_{name}"], figures[f"wrist_mm_{name}"] = map(float, outcome.joints.mean(0))
        figures[f"frame_ms_{name}"] = outcome.milliseconds
    none = outcomes["none"]
    for name in ("energy", "priorities"):
        figures[f"bad_frames_ratio_{name}"] = float(outcomes[name].is_bad.sum() / none.is_bad.sum())
        figures[f"time_ratio_{name}"] = outcomes[name].milliseconds / none.milliseconds
    own = outcomes["none_strict"].milliseconds
    figures["time_ratio_priorities_own_solver"] = outcomes["priorities"].milliseconds / own
    return figures


def depth(shared: Path, count: int | None) -> dict[str, float]:
    body = jc.human(resolution="low", joints="tracking")
    limits = learn_from(shared, takes_of(shared, "01") + takes_of(shared, "02"), body, LIMITED_JOINTS)
    fitted = fit_frames(depth_frames(shared)[:count], limits)
    return {
        "depth_frames": len(fitted),
        "depth_valid_percent": 100 * float(np.mean([one.valid.all() for one in fitted])),
        "depth_valid_after_search_percent": 100 * float(np.mean([one.initial_valid.all() for one in fitted])),
        "depth_median_mm": float(np.median([one.distance_mm for one in fitted])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.limits_track", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--motions", nargs="+", default=TAKES, help="takes of subject 02 to track")
    parser.add_argument("--frames", type=int, help="number of frames of each take to track")
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        help="track every n-th frame only; movements are then n times faster",
    )
    parser.add_argument("--repeats", type=int, default=3, help="number of timed runs")
    parser.add_argument("--depth-frames", type=int, help="number of depth frames to fit")
    options = parser.parse_args()
    shared, start = shared_folder(), time.perf_counter()
    figures = tracking(shared, tuple(options.motions), options.frames, options.every, options.repeats)
    figures |= depth(shared, options.depth_frames)
    limits = {
        "bad_frames_ratio_energy": ("<=", 0.5),
        "bad_frames_ratio_priorities": ("<=", 0.5),
        "time_ratio_energy": ("<=", 1.25),
        "depth_valid_percent": (">=", 100.0),
    }
    sizes = {"takes": list(options.motions), "stereo": STEREO._asdict(), "steps": STEPS}
    finish("limits_track", figures, limits, sizes, {"total": time.perf_counter() - start})


if __name__ == "__main__":
    main()
