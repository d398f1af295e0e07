"""Learn an animatable body from registered meshes: three improvements in turn, until Q is least."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..geometry.laplacian import make_conformance
from ..observe import MeshSequence
from .joints import improve_joints
from .objective import objective
from .start import SkinName, Start, start_free, start_from_motion, start_from_skeleton
from .vertices import VertexSolver
from .weights import improve_weights

#: a round that lowers Q by less than this share is the last
ENOUGH = 2e-3
#: damping of the first step of joints and poses
FIRST_DAMPING = 1e-3
#: steps of Gauss-Newton on joints and poses, before the first round and in each
FIRST_STEPS, STEPS = 4, 2


class LearnState(NamedTuple):
    """Where learning stands after a round: all that is needed to go on."""

    body: Body
    #: the poses of the meshes
    motion: Motion
    #: left and right joints of which the bones stay equally long
    pairs: Int[np.ndarray, "P 2"]
    damping: float
    #: (step, Q) from the start on, Q in squared metres
    history: tuple[tuple[str, float], ...]
    round: int


class Learned(NamedTuple):
    """A learned body, the poses of the meshes it was learned from, and how it came about."""

    body: Body
    motion: Motion
    #: left and right joints
    pairs: Int[np.ndarray, "P 2"]
    #: (step, Q): after the start, and after every improvement; Q never rises
    history: tuple[tuple[str, float], ...]
    #: root mean square error over the number of rigid parts, metres; empty where it was not asked
    curve: Float[np.ndarray, "N"]


def learn_body(
    meshes: MeshSequence,
    *,
    joints: int | None = None,
    skin: SkinName = "swing_twist",
    alpha: float = 100.0,
    symmetry: bool | Int[np.ndarray, "P 2"] = True,
    skeleton: Skeleton | None = None,
    free_bones: bool = False,
    rounds: int = 12,
    on_round: Callable[[LearnState], None] | None = None,
    resume: LearnState | None = None,
) -> Learned:
    """A body that follows registered meshes of one actor (Adaptation, section 3.2).

    Rigid parts, joints and poses are found first (3.2.1). Then skinning weights, rest vertices,
    and joints with all poses are improved in turn, each by what it can lower of

        Q = sum |x - T(v)|^2 + alpha |L(x - T(v))|^2        (eq. 3.19)

    until a round lowers it by less than a five hundredth, or `rounds` are over.

    **Arguments:** `joints` between parts, as many as the motion shows where None; `skin` says how
    vertices follow; `alpha` weighs shape against distance; `symmetry` keeps left and right bones
    equally long, in pairs that are found or given as `(P, 2)` indices of joints; `skeleton`, which
    stands in the first mesh, replaces the joints that would be found; `free_bones` hang on
    nothing, and blend linearly. `on_round` sees the state after every round; `resume` goes on
    from one, to the same result.

    **Raises:** `ValueError` with one sentence for meshes or options from which nothing is learned.
    """
    targets = meshes.vertices
    metric = make_conformance(np.asarray(meshes.faces), targets.shape[1], alpha)
    curve = np.zeros(0)
    if resume is None:
        start = _start(meshes, joints, skin, symmetry, skeleton, free_bones)
        curve = start.curve
        value = float(objective(start.body, start.poses, targets, metric))
        state = LearnState(
            start.body, Motion(start.poses, meshes.rate), start.pairs, FIRST_DAMPING, (("start", value),), 0
        )
        state = _improve_joints(state, meshes, metric, FIRST_STEPS)
    else:
        state = resume
    vertices = VertexSolver(metric)
    while state.round < rounds and not _settled(state):
        state = _round(state, meshes, metric, vertices)
        if on_round is not None:
            on_round(state)
    return Learned(state.body, state.motion, state.pairs, state.history, curve)


def _start(meshes, joints, skin, symmetry, skeleton, free_bones) -> Start:
    if free_bones:
        return start_free(meshes, joints)
    if skeleton is not None:
        return start_from_skeleton(meshes, skeleton, skin, symmetry)
    return start_from_motion(meshes, joints, skin, symmetry)


def _settled(state: LearnState) -> bool:
    """Whether the last round lowered Q by little."""
    ends = [value for step, value in state.history if step == "joints"]
    if state.round < 2:
        return False
    return ends[-1] > (1 - ENOUGH) * ends[-1 - STEPS]


def _round(state: LearnState, meshes: MeshSequence, metric, vertices: VertexSolver) -> LearnState:
    poses, targets = state.motion.poses, meshes.vertices
    better = improve_weights(state.body, poses, targets, metric).body
    state = _keep(state, better, meshes, metric, "weights")
    moved = eqx.tree_at(lambda b: b.vertices, state.body, vertices.solve(state.body, poses, targets))
    state = _keep(state, moved, meshes, metric, "vertices")
    state = _improve_joints(state, meshes, metric, STEPS)
    return state._replace(round=state.round + 1)


def _keep(state: LearnState, body: Body, meshes, metric, step: str) -> LearnState:
    """The state with a better body; where rounding made it worse, as it was."""
    before = state.history[-1][1]
    value = float(objective(body, state.motion.poses, meshes.vertices, metric))
    kept = body if value <= before else state.body
    return state._replace(body=kept, history=(*state.history, (step, min(value, before))))


def _improve_joints(state: LearnState, meshes: MeshSequence, metric, steps: int) -> LearnState:
    for _ in range(steps):
        poses, value = state.motion.poses, state.history[-1][1]
        found = improve_joints(
            state.body, poses, meshes.vertices, metric, state.pairs, state.damping, value
        )
        state = state._replace(
            body=found.body,
            motion=Motion(found.poses, state.motion.rate),
            damping=found.damping,
            history=(*state.history, ("joints", found.value)),
        )
    return state
