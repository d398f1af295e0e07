"""Learning rounds for a body with linear blend skinning and a weak Laplacian term, by variable projection."""

from collections.abc import Callable

from jaxtyping import Array, Float

from ...body.pose import Motion
from ..joint_exchange.exchange_joints import exchange_joints
from ..joint_exchange.insert_and_remove import EditedBody
from ..state import LearnState
from ..symmetry.surface_symmetry import SurfaceSymmetry
from .solve_blend_problem import improve_body

#: the number of vertices from which bones are learned
VERTICES = 2000
#: updates of the candidate bones of vertices in a round and in a trial, and steps after each
PASSES, TRIAL_PASSES, STEPS = 2, 1, 5
#: joints are exchanged once a round keeps more than the first share of Q; rounds end when one lowers Q by
#: less than the second
EXCHANGE_RATIO, MIN_DECREASE = 0.5, 0.05
#: root mean square error below which learning ends, as a share of the body's height
EXACT = 5e-6
#: trials of an exchange
TRIALS = 3


def improve_linear_skin(
    state: LearnState,
    targets: Float[Array, "F V 3"],
    rounds: int,
    on_round: Callable[[LearnState], None] | None,
    allow_exchange: bool,
    variable_count: bool,
    prefix: str,
    symmetry: SurfaceSymmetry | None = None,
) -> LearnState:
    """Improve a body until a round lowers Q, here the squared distances alone, by little.

    From the second round on, joints are exchanged when steps alone no longer lower Q by much.

    **Arguments:** `allow_exchange` allows the exchange of joints, and `variable_count` a change of their number; `prefix`
    begins the names of steps in the history; with a `symmetry`, joints are exchanged in pairs or on the middle.
    """
    while state.round < rounds and not _done(state, targets, allow_exchange, prefix):
        if allow_exchange and _slow(state, prefix):
            trial, step = _trial(targets, prefix), prefix + "exchange"
            state = exchange_joints(state, targets, trial, step, TRIALS, variable_count, symmetry)
        made = EditedBody(state.body, state.motion.poses, state.left_right_pairs)
        state = _improve(state, made, targets, prefix + "projection", PASSES)
        state = state._replace(round=state.round + 1)
        if on_round is not None:
            on_round(state)
    return state


def _trial(targets, prefix: str) -> Callable[[LearnState, EditedBody], LearnState]:
    return lambda state, made: _improve(state, made, targets, prefix + "trial", TRIAL_PASSES)


def _improve(state: LearnState, made: EditedBody, targets, step: str, passes: int) -> LearnState:
    found = improve_body(made.body, made.poses, targets, made.left_right_pairs, rounds=passes, steps=STEPS)
    return state._replace(
        body=found.body,
        motion=Motion(found.poses, state.motion.rate),
        left_right_pairs=made.left_right_pairs,
        history=(*state.history, (step, found.value)),
    )


def _rounds(state: LearnState, prefix: str) -> list[tuple[float, float]]:
    """Return Q before and after each round."""
    values = [value for _, value in state.history]
    return [
        (values[i - 1], values[i])
        for i, (name, _) in enumerate(state.history)
        if name == prefix + "projection" and i > 0
    ]


def _slow(state: LearnState, prefix: str) -> bool:
    rounds = _rounds(state, prefix)
    return bool(rounds) and rounds[-1][1] > EXCHANGE_RATIO * rounds[-1][0]


def _done(state: LearnState, targets, exchanging: bool, prefix: str) -> bool:
    ends = [after for _, after in _rounds(state, prefix)]
    height = float((targets[0].max(0) - targets[0].min(0)).max())
    exact = (EXACT * height) ** 2 * targets.shape[0] * targets.shape[1]
    settled = len(ends) > 1 and ends[-1] > (1 - MIN_DECREASE) * ends[-2]
    exchanged = len(ends) > 0 and state.history[-2][0] == prefix + "exchange"
    return len(ends) > 0 and (ends[-1] < exact or (settled and (exchanged or not exchanging)))
