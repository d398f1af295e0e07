"""Find the pose of a person in a single cloud without an initial pose, in 100 random frames.

    python -m benchmarks.first_frame
    python -m benchmarks.first_frame --frames 5

Frames are drawn from all takes of CMU's subject 02 and turned about the vertical by a random
angle; the scans are those of `track_cmu`. A frame is solved when the mean error of its 31 joint
centres is below 30 mm. Run it from the root of the checkout.
"""

import argparse
import time

import equinox as eqx
import jax
import numpy as np

import jaxcap as jc
from benchmarks._scenes import (
    NOISE,
    cmu_motion,
    rotation_about_y,
    scan_frame,
    shared_folder,
    takes_of,
)
from benchmarks.report import finish, progress
from jaxcap.metrics import joint_errors

SUBJECT = "02"
#: mean joint error below which a frame is solved, millimetres
MAX_SOLVED_ERROR = 30.0
#: largest median time of a frame after the first one, which compiles, seconds
MAX_SECONDS = 2.0

_posed = eqx.filter_jit(jc.pose_body)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.first_frame", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    shared, noise = shared_folder(), NOISE
    subject = jc.human()
    tracker = jc.make_tracker(jc.human(resolution="medium"))
    names = tracker.body.skeleton.names
    takes = {take: cmu_motion(shared, take) for take in takes_of(shared, SUBJECT)}
    every = [(take, frame) for take, (motion, _) in takes.items() for frame in range(motion.num_frames)]
    rng = np.random.default_rng(options.seed)

    means, taken, failures = [], [], []
    # so drawn, a shorter run sees the first frames of a longer one
    for number, index in enumerate(rng.permutation(len(every))[: options.frames]):
        take, frame = every[index]
        motion, skeleton = takes[take]
        pose = jc.retarget(motion.slice(slice(frame, frame + 1)), skeleton, subject.skeleton)[0]
        own = np.random.default_rng([options.seed, number])
        angle = own.uniform(0, 2 * np.pi)
        scanned = scan_frame(subject, pose, own, noise, turn=rotation_about_y(angle))
        start = time.perf_counter()
        found, score = jax.block_until_ready(jc.initialise(tracker, scanned.cloud))
        taken.append(time.perf_counter() - start)
        joints = np.asarray(_posed(tracker.body, found).joints)
        errors = 1000 * joint_errors(joints[None], scanned.joints[None])[0]
        means.append(errors.mean())
        solved = errors.mean() < MAX_SOLVED_ERROR
        if not solved:
            failures.append({"take": take, "frame": frame, "mean_mm": errors.mean()})
        progress(
            f"{number:3d} {take} frame {frame:4d}, turned {np.degrees(angle):3.0f} degrees: mean "
            f"{errors.mean():6.1f} mm, worst {errors.max():6.1f} mm at {names[errors.argmax()]}, "
            f"log-likelihood {float(score):.2f}, {taken[-1]:.1f} s{'' if solved else '  NOT SOLVED'}"
        )

    means = np.array(means)
    good = means < MAX_SOLVED_ERROR
    figures = {
        "solved": int(good.sum()),
        "solved_share": good.mean(),
        "solved_mean_mm": means[good].mean() if good.any() else float("nan"),
        "median_mm": np.median(means),
        "seconds_per_frame": np.median(taken[1:] or taken),
        "failures": failures,
    }
    sizes = {
        "frames": options.frames,
        "points": noise.points,
        "vertices": len(tracker.body.vertices),
        "numbers": tracker.body.skeleton.num_dofs,
        "noise": noise._asdict(),
    }
    seconds = {"compile": taken[0], "run": sum(taken[1:]), "median_run": float(np.median(taken[1:] or taken))}
    finish(
        "first_frame",
        figures,
        {"solved_share": (">=", 0.95), "seconds_per_frame": ("<=", MAX_SECONDS)},
        sizes,
        seconds,
    )


if __name__ == "__main__":
    main()
