"""Validate learned joint limits on held-out halves of motions: `python -m benchmarks.limits_holdout`.

First a known limit that couples swing with twist and elbow with shoulder: how often a learned one
is right about poses that are not within three degrees of its border. Then shoulders and elbows,
hips and knees of the CMU database: how many of the frames not learned from are allowed, and how
many are rejected of rotations drawn evenly, of children with other frames' parents, of twists the
other way round, and of pairs that were seen apart and never together; by boxes of Euler angles, by
independent surfaces and by the hierarchy, from the same frames.
"""

import argparse
import time

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from benchmarks._scenes import shared_folder
from benchmarks.limits._limits import (
    PAIRS,
    clear_compiled,
    cmu_motions,
    hinge_rotations,
    mirrored_twist,
    motion_of,
    pair_skeleton,
    true_samples,
    true_slack,
    uniform_rotations,
)
from benchmarks.report import finish, progress
from jaxcap.cli.limits.motion_limits import format_runs
from jaxcap.geometry import rotation
from jaxcap.limits.frame_evaluation import allowed_frames
from jaxcap.limits.learning.boxes import learn_boxes
from jaxcap.limits.learning.learn_limits import learn_limits
from jaxcap.limits.learning.samples import JointSamples, gather_samples

#: degrees around the border where the known limit is not asked about
BORDER_WIDTH = 3.0
#: a pair was seen together where both joints were within so many degrees of it in one frame
MAX_PAIR_ANGLE = 15.0
KINDS = ("uniform", "shuffled", "mirrored", "never together")


def score_known_limit(samples: int, questions: int) -> dict[str, float]:
    """Compute the percentages of right answers for an analytic limit."""
    rng, skeleton = np.random.default_rng(1), pair_skeleton()
    shoulder, elbow = true_samples(rng, samples)
    motion = motion_of(skeleton, {"shoulder": shoulder, "elbow": elbow})
    given = gather_samples([(skeleton, motion)], "elbow", "shoulder")
    assert given.parent is not None
    limits = learn_limits(
        {"shoulder": given.parent, "elbow": given}, voxel=np.radians(3), keyframe=np.radians(5)
    )
    sizes = [surface.centres.shape[:2] for surface in limits.surfaces]
    progress(f"known limit: {sizes} keyframes and primitives")
    # around what is allowed, where it is hard, and everywhere
    inside = true_samples(rng, questions // 2)
    turned = 1.5 * np.radians(75) * np.cbrt(rng.uniform(size=questions))[:, None]
    axis = uniform_rotations(rng, questions)[:, 1:]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    around = np.concatenate([np.cos(turned / 2), np.sin(turned / 2) * axis], 1)
    bends = hinge_rotations(np.array([1.0, 0, 0]), rng.uniform(-np.pi, np.pi, questions))
    asked = np.concatenate([inside[0], around]), np.concatenate([inside[1], bends])
    slack = true_slack(*asked)
    told = np.asarray(
        allowed_frames(
            limits, skeleton, motion_of(skeleton, dict(zip(("shoulder", "elbow"), asked, strict=True)))
        )
    )
    clear = np.abs(slack) > np.radians(BORDER_WIDTH)
    # a child is asked about where its parent is allowed
    parent = clear[:, 0]
    child = clear.all(1) & (slack[:, 0] > 0)
    right = told == (slack >= 0)
    return {
        "known_parent_right_percent": 100 * right[parent, 0].mean(),
        "known_child_right_percent": 100 * right[child, 1].mean(),
        "known_right_percent": 100
        * (right[parent, 0].sum() + right[child, 1].sum())
        / (parent.sum() + child.sum()),
    }


def are_allowed(limits, skeleton, poses: dict[str, np.ndarray]) -> np.ndarray:
    """Test which poses all of some limits allow at both joints."""
    motion = motion_of(skeleton, poses)
    return np.all([np.asarray(allowed_frames(one, skeleton, motion)).all(1) for one in limits], axis=0)


def make_negatives(
    train: JointSamples, test: JointSamples, whole: JointSamples, skeleton, count: int
) -> dict:
    """Make negative samples, by kind."""
    rng = np.random.default_rng(2)
    assert test.parent is not None and train.parent is not None and whole.parent is not None
    some = rng.integers(0, len(test.rotations), (2, count))
    children, parents = test.rotations[some[0]], test.parent.rotations[some[1]]
    twist = np.asarray(
        rotation.rotate(skeleton.orientations[skeleton.index(test.parent.joint)], jnp.array([1.0, 0, 0]))
    )
    joint, parent = test.joint, test.parent.joint
    seen = embed_pairs(whole.rotations, whole.parent.rotations)
    distances = KDTree(seen).query(embed_pairs(children, parents), p=np.inf)[0]
    never = distances > 2 * np.sin(np.radians(MAX_PAIR_ANGLE) / 4)
    return {
        "uniform": {
            parent: uniform_rotations(rng, count),
            joint: hinge_rotations(test.axes[0], rng.uniform(-np.pi, np.pi, count)),
        },
        "shuffled": {parent: parents, joint: children},
        "mirrored": {parent: mirrored_twist(test.parent.rotations[some[0]], twist), joint: children},
        "never together": {parent: parents[never], joint: children[never]},
    }


def embed_pairs(children: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Embed pairs of rotations such that distances are chords of quaternions; rotations are below half a turn."""
    return np.concatenate([np.where(q[:, :1] < 0, -q, q) for q in (children, parents)], 1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--questions", type=int, default=20_000)
    parser.add_argument("--only", choices=("known", "cmu"))
    options = parser.parse_args()
    start, figures = time.perf_counter(), {}
    if options.only != "cmu":
        figures |= score_known_limit(options.samples, options.questions)
        progress(f"known limit: {figures}")
        clear_compiled()
    if options.only != "known":
        figures |= score_captured(options.questions)
    limits = {"known_right_percent": (">=", 99.0), "test_allowed_percent": (">=", 97.0)}
    for kind in KINDS:
        rivals = [
            figures.get(f"{kind.replace(' ', '_')}_{scheme}", 0.0) for scheme in ("boxes", "independent")
        ]
        limits[f"{kind.replace(' ', '_')}_hierarchy"] = (">=", max(rivals))
    limits["never_together_over_boxes"] = (">=", 30.0)
    limits = {name: limit for name, limit in limits.items() if name in figures}
    finish(
        "limits_holdout",
        figures,
        limits,
        {"samples": options.samples},
        {"total": time.perf_counter() - start},
    )


def score_captured(count: int) -> dict[str, float]:
    """Compute the percentages for the joints of the database, by pair and over all pairs."""
    motions = cmu_motions(shared_folder())
    skeleton = motions[0][0]
    kept, rejected, out = [], {}, []
    for parent, joint in PAIRS:
        whole = gather_samples(motions, joint, parent)
        train, test = (whole.take(np.flatnonzero(whole.blocks % 2 == half)) for half in (0, 1))
        assert train.parent is not None and test.parent is not None
        boxes = learn_boxes(skeleton, [train.parent, train])
        independent = learn_limits(
            {parent: train.parent, joint: train._replace(parent=None)}, held_out="blocks"
        )
        together = learn_limits({parent: train.parent, joint: train}, held_out="blocks")
        schemes = {"boxes": boxes, "independent": (independent,), "hierarchy": (together,)}
        asked = make_negatives(train, test, whole, skeleton, count)
        for scheme, limits in schemes.items():
            good = are_allowed(limits, skeleton, {parent: test.parent.rotations, joint: test.rotations})
            line = [f"{scheme:12s} allows {100 * good.mean():6.2f} % of the other half, rejects"]
            if scheme == "hierarchy":
                kept.append(good)
                outside = ~good
                out.append((joint, outside))
            for kind, poses in asked.items():
                no = 100 * (1 - are_allowed(limits, skeleton, poses).mean())
                rejected.setdefault((kind, scheme), []).append(no)
                line.append(f"{kind} {no:5.1f} %")
            progress(f"{parent}:{joint} " + ", ".join(line))
        widths = [float(np.degrees(4 * s.unit)) for s in together.surfaces]
        progress(
            f"{parent}:{joint} voxels of {widths} degrees, {[s.centres.shape[:2] for s in together.surfaces]}"
        )
        clear_compiled()
    for joint, outside in out:
        progress(
            f"{joint}: {outside.sum()} frames of the other half are beyond the limits: {format_runs(outside, 6)}"
        )
    figures = {
        f"{kind.replace(' ', '_')}_{scheme}": float(np.mean(v)) for (kind, scheme), v in rejected.items()
    }
    figures["test_allowed_percent"] = 100 * float(np.mean(np.concatenate(kept)))
    figures["test_allowed_worst_pair_percent"] = 100 * min(float(good.mean()) for good in kept)
    figures["test_all_pairs_allowed_percent"] = 100 * float(np.all(kept, axis=0).mean())
    figures["never_together_over_boxes"] = (
        figures["never_together_hierarchy"] - figures["never_together_boxes"]
    )
    return figures


if __name__ == "__main__":
    main()
