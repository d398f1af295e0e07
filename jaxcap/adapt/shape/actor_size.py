"""The size of an actor relative to the template, with the first poses (Adaptation, 4.1.4)."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...body.body import Body, scale_body
from ...body.pose import Pose
from ...energy.data.pairs import stack_pairs
from ...fit.alternate import alternate
from ...fit.correspondence.find_pairs import Matching
from ...fit.correspondence.nearest_assignment import IndexedScan
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.sequences.unknowns import Size
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.camera import Camera
from ...stacking import stack_trees, unstack_trees
from ..objective import PoseTerms, window_problem
from ..poses.fit_frame import MAX_UPHILL_STEPS, STEP_FACTORS, pairs_of

#: limits of an actor's size relative to the template
MIN_SIZE, MAX_SIZE = 0.5, 2.0


def fit_size(
    body: Body,
    scans: Sequence[IndexedScan],
    poses: Sequence[Pose],
    terms: PoseTerms,
    matching: Matching,
    rounds: int = 24,
    cameras: Sequence[Camera] = (),
    initial_size: float = 1.0,
) -> tuple[Body, list[Pose], float]:
    """Scale a body to the actor, and refine its poses in some scans.

    Each iteration finds new pairs and takes a step on all poses and the size that they share. Return the
    body, the poses and the scale of this call.

    **Arguments:** `terms` and `cameras` as in `fit_pose`; `initial_size`, the body's size relative to the
    template.
    """
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=1e-3, relative=True, lengths=STEP_FACTORS)
    count = len(scans)

    def remake(y: SequenceEstimate) -> SequenceProblem:
        scaled = scale_body(body, jnp.exp(y.values["size"]))
        pairs = [
            pairs_of(scaled, pose, scan, matching, cameras)
            for pose, scan in zip(unstack_trees(y.poses, count), scans, strict=True)
        ]
        stacked = stack_pairs(pairs)
        problem = window_problem(body, stacked, terms, 0.0, np.arange(count))
        unknown = {"size": Size(MIN_SIZE / initial_size, MAX_SIZE / initial_size)}
        return eqx.tree_at(lambda p: (p.unknowns, p.between), problem, (unknown, ()))

    start = SequenceEstimate(stack_trees(poses), {"size": jnp.zeros((), body.vertices.dtype)})
    found = alternate(remake, start, solver, rounds=rounds, min_gain=1e-3, patience=MAX_UPHILL_STEPS).y
    size = float(jnp.exp(found.values["size"]))
    return scale_body(body, jnp.asarray(size, body.vertices.dtype)), unstack_trees(found.poses, count), size
