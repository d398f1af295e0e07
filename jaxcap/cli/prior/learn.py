"""`jaxcap prior learn`: a pose prior from motions, and a shape prior from meshes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...adapt.shape.shape_prior import ShapePrior
from ...body.body import Body
from ...body.matching.plan import plan_retarget
from ...body.pose import Motion
from ...body.skeleton import Skeleton, has_same_joints
from ...edit.retargeting.retarget import retarget
from ...errors import InputError, user_message
from ...io.archives.npz import load_body_limits
from ...io.archives.prior import save_prior
from ...prior.covariance_selection import count_zero_couplings
from ...prior.learn_pose_prior import LearnedPair, build_pair_prior, learn_pairs, learn_ranges
from ..body_models import is_own_file
from ..console.console import pluralise, print_table, progress, say, warn
from ..console.options import BODY_FORMATS, MOTION_FORMATS, Flag, MotionsSpec, OptionalBody, OptionalUnit, arg
from ..motions import load_motion
from ..outputs import check_npz
from ..sources import load_body
from .shape import learn_shape

OptionalMeshes = Annotated[tuple[str, ...], arg(metavar="MESHES...", help_behavior_hint="")]

#: maximum sine of the angle between equal bones at rest: 3 degrees
MAX_SINE = 0.05


@dataclass
class Learn:
    """Learn a pose prior from motions: a mixture of Gaussians for each joint with its parent, and the range of
    each joint.

    The number of Gaussians is the one that best predicts held-out motion. --meshes adds a prior of the shape around
    every vertex."""

    motions: Annotated[
        MotionsSpec,
        arg(help=f"Motions, of one skeleton unless --body is given: {MOTION_FORMATS}."),
    ]
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output file for the prior, .npz."""
    body: Annotated[
        OptionalBody,
        arg(
            help=f"Body of the prior: {BODY_FORMATS}. The output file also contains this body. Motions of other "
            "skeletons are retargeted to it."
        ),
    ] = None
    meshes: OptionalMeshes = ()
    """Registered meshes of --body, for the shape around its vertices: mesh files, a folder, a quoted glob, or an .npz
    with the arrays `vertices` (F, V, 3), for F meshes of V vertices, and `faces`."""
    rate: Annotated[float, arg(metavar="FPS")] = 30.0
    """Largest number of frames per second to learn from. Neighbouring frames add little information."""
    max_gaussians: Annotated[int, arg(metavar="N")] = 10
    """Largest number of Gaussians for a pair of joints."""
    min_deviation: Annotated[float, arg(metavar="DEGREES")] = 2.0
    """Smallest standard deviation of a Gaussian in any direction, degrees."""
    margin: Annotated[float, arg(metavar="DEGREES")] = 0.0
    """Margin added at both ends of the range of each joint, degrees. In `jaxcap adapt` joints cannot
    leave this range; other verbs do not use it. Give a margin if
    the motions have few poses, which may not show the whole range."""
    seed: int = 0
    """Seed of the random initial values."""
    unit: OptionalUnit = None
    """Unit of the files' lengths, instead of the unit that they state. Default for meshes: metres."""
    overwrite: Flag = False
    """Replace the prior if it exists."""

    def run(self) -> None:
        self.check()
        body = None if self.body is None else load_body(self.body, unit=self.unit or "m")[0]
        skeleton, motions = self.read(body)
        frames = sum(len(motion) for motion in motions)
        say(f"learning from {pluralise(len(motions), 'motion')}, {pluralise(frames, 'pose')}")
        shape = self.read_shape(body)
        try:
            learned = learn_pairs(
                skeleton,
                motions,
                max_components=self.max_gaussians,
                min_deviation=float(np.radians(self.min_deviation)),
                seed=self.seed,
                progress=lambda pairs, total: progress(pairs, total, label="learning", noun="pairs"),
            )
            prior, boxes = (
                build_pair_prior(skeleton, learned),
                learn_ranges(skeleton, motions, float(np.radians(self.margin))),
            )
        except ValueError as error:
            raise InputError(f"{', '.join(self.motions)}: {user_message(error)}") from None
        own = self.body is not None and is_own_file(self.body)
        limits = load_body_limits(str(self.body)) if own else None
        save_prior(self.out, prior, boxes, body, limits, shape)
        print_summary(learned)
        say(f"written: {self.out}")

    def check(self) -> None:
        """Check that options are in range and compatible. Raises `InputError`."""
        if not self.motions:
            raise InputError("There are no motions to learn from; give .bvh, .amc or .npz files.")
        check_npz(self.out, self.overwrite, "a prior")
        if not 0 < self.rate < np.inf:
            raise InputError(f"--rate is {self.rate:g}; it must be above 0 frames per second.")
        if not 1 <= self.max_gaussians <= 100:
            raise InputError(f"--max-gaussians is {self.max_gaussians}; it must be between 1 and 100.")
        if not 0.01 <= self.min_deviation <= 45:
            raise InputError(
                f"--min-deviation is {self.min_deviation:g}; it must be between 0.01 and 45 degrees."
            )
        if not 0 <= self.margin <= 180:
            raise InputError(f"--margin is {self.margin:g}; it must be between 0 and 180 degrees.")
        if self.seed < 0:
            raise InputError(f"--seed is {self.seed}; it must be at least 0.")
        if self.meshes and self.body is None:
            raise InputError("--meshes needs a body; give it with --body.")

    def read(self, body: Body | None) -> tuple[Skeleton, list[Motion]]:
        """Read the skeleton of the prior, and the subsampled motions. Raises `InputError` if they are of
        different skeletons, and cannot be retargeted to the body's."""
        pairs = [load_motion(path, self.unit) for path in self.motions]
        skeleton = pairs[0][0] if body is None else body.skeleton
        motions, carried = [], 0
        for path, (other, motion) in zip(self.motions, pairs, strict=True):
            # a tolerance, so that a slightly inexact rate is subsampled like an integer one
            step = max(1, int(motion.rate / self.rate + 1e-3))
            motion = motion.slice(slice(None, None, step))
            if not same_bones(skeleton, other):
                if body is None:
                    raise InputError(
                        f"{path}: this motion has the joints {', '.join(other.names)}, and {self.motions[0]} has "
                        f"{', '.join(skeleton.names)}, or the rest poses differ; give motions of one skeleton, or give "
                        "with --body the body to retarget them to."
                    )
                try:
                    plan = plan_retarget(other, skeleton, None, motion)
                except ValueError as error:
                    raise InputError(f"{path}: {user_message(error)}") from None
                for line in plan.matches.warnings:
                    warn(f"{path}: {line}")
                motion, carried = retarget(motion, other, skeleton, plan=plan), carried + 1
            motions.append(motion)
        if carried:
            say(f"{carried} of {len(motions)} motions retargeted to the skeleton of {self.body}")
        return skeleton, motions

    def read_shape(self, body: Body | None) -> ShapePrior | None:
        """Learn the shape prior of the meshes; None if there are none."""
        return learn_shape(body, self.meshes, self.unit or "m") if self.meshes and body is not None else None


def same_bones(one: Skeleton, other: Skeleton) -> bool:
    """Check if rotations of one skeleton apply to the other: the same joints, with parallel bones at rest, of
    any length."""
    if not has_same_joints(one, other):
        return False
    below = [joint for joint, parent in enumerate(one.parents) if parent >= 0]
    above = [one.parents[joint] for joint in below]
    ways = [np.asarray(s.centres, float)[below] - np.asarray(s.centres, float)[above] for s in (one, other)]
    lengths = [np.linalg.norm(way, axis=1) for way in ways]
    not_parallel = np.linalg.norm(np.cross(ways[0], ways[1]), axis=1) > MAX_SINE * lengths[0] * lengths[1]
    turned = np.sum(ways[0] * ways[1], axis=1) < 0
    return not np.any(not_parallel | turned)


def print_summary(learned: tuple[LearnedPair, ...]) -> None:
    """Print a row for each pair: its Gaussians, and the likelihood of held-out poses."""
    rows = []
    for (above, below), chosen in learned:
        zeroed, all_of_them = count_zero_couplings(chosen.mixture.precisions)
        rows.append(
            [
                f"{above}, {below}",
                str(len(chosen.mixture.weights)),
                f"{chosen.single_log_likelihood:.2f}",
                f"{chosen.best_log_likelihood:.2f}",
                f"{zeroed} of {all_of_them}",
            ]
        )
    print_table(["pair", "Gaussians", "held out: one", "chosen", "zeroed"], rows)
