"""Label unlabelled markers by a known subject: `python -m benchmarks.markers_label`.

Motions of CMU on the embedded human with sets of 41 and 53 markers, 30 seconds each: noise of a millimetre, skin that slides
by up to a centimetre, a tenth of the places missing in bursts, and ghosts at 5 % of the places. Labels are taken away: every
piece of a trajectory has a column of its own or shares one with others, in random order. A place is right if it has the
label of its marker. A wrong label may last for a tenth of a second.
"""

import argparse
import time

import jax
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.markers._markers import MarkerNoise, scene_of
from benchmarks.markers._unlabelled import hide_labels, label_errors, laboratory_subject
from benchmarks.report import finish, progress

TAKES = {41: ("01_02", "02_05"), 53: ("01_11", "02_06")}
SECONDS, GHOSTS = 30.0, 0.05
NOISE = MarkerNoise(noise=1e-3, gaps=0.1, skin=0.01)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_label", description="Label unlabelled markers by a known subject."
    )
    parser.add_argument("--markers", type=int, choices=sorted(TAKES), help="one marker set only")
    parser.add_argument("--takes", nargs="+", help="takes of CMU instead of the usual ones")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of each take")
    parser.add_argument("--seed", type=int, default=0, help="seed of noise, gaps and ghosts")
    options = parser.parse_args()
    right, wrong, longest, rates = [], [], [], []
    for count in [options.markers] if options.markers else sorted(TAKES):
        subject = laboratory_subject(count)
        for take in options.takes or TAKES[count]:
            motion, skeleton = cmu_motion(shared_folder(), take)
            motion = motion.slice(slice(round(options.seconds * motion.rate)))
            motion = jc.retarget(motion, skeleton, subject.skeleton)
            motion = jax.tree.map(lambda leaf: leaf.astype(np.float32), motion)
            scene = scene_of(subject, motion, NOISE, options.seed)
            hidden = hide_labels(scene.frames, GHOSTS, np.random.default_rng(options.seed))
            start = time.perf_counter()
            found = jc.markers.label_markers(subject, hidden.frames)
            taken = time.perf_counter() - start
            errors = label_errors(subject, hidden, found)
            right.append(errors.right)
            wrong.append(errors.wrong)
            longest.append(errors.longest)
            rates.append(len(hidden.frames) / taken)
            progress(
                f"{count} markers, {take}: {len(hidden.frames)} frames in {taken:.1f} s, {100 * errors.right:.2f} % right, "
                f"{100 * errors.wrong:.3f} % wrong, at most for {errors.longest:.2f} s"
            )
    figures = {
        "right": min(right),
        "wrong": max(wrong),
        "longest_wrong_seconds": max(longest),
        "frames_per_second": min(rates),
    }
    limits = {"right": (">=", 0.995), "longest_wrong_seconds": ("<=", 0.1)}
    finish("markers_label", figures, limits, {"takes": len(right)}, {})


if __name__ == "__main__":
    main()
