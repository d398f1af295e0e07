"""Optimisation of skinning weights by block coordinate descent (Adaptation, 3.2.2).

With everything else fixed, `Q = sum e . A e` of the errors `e = targets - posed` depends on one vertex `v` as
`a_vv |y_v - T_v|^2` and a constant, where

    y_v = T_v + (A e)_v / a_vv

is the optimal position of the vertex in each frame. The choice of its weights is therefore a small
independent problem with an exact gain, and vertices not coupled by `A` are updated at once: one colour at a
time. Vertices with no changes around them since their last update are skipped.

Updates of single vertices close cracks at once, but errors common to a whole limb converge slowly, by `1 /
alpha` a sweep. The Laplacian hardly affects these errors. The first sweeps therefore use little of `alpha` or
none, so that vertices move independently, and the other sweeps close the cracks. If Q then exceeds that at
the start, as it may near the optimum, these sweeps are undone, and all sweeps use the full `alpha`.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose
from ...body.skin import LinearSkin, RigidSkin, SwingTwistSkin
from ...geometry.laplacian import Conformance
from .coordinate_descent import ErrorField, error_field, field_energy, make_blocks, scale_alpha, sweep
from .graph_colouring import colour_vertices, within_two_rings
from .linear_weights import RigidWeightSolver, make_linear_weight_solver
from .swing_twist_weights import (
    NUM_NEIGHBOURS,
    STEPS,
    make_swing_twist_weight_solver,
    rows_to_skin,
    skin_to_rows,
)


class SweepSettings(NamedTuple):
    """The settings of a sweep.

    They are the share of alpha, the length of slides (zero: Gauss-Newton steps only), and the scale of aims
    for linear skins.
    """

    alpha_share: float
    slide_length: float
    relaxation: float


COARSE = (
    SweepSettings(0.0, 0.25, 1.0),
    SweepSettings(0.0, 0.05, 1.0),
    SweepSettings(0.05, 0.2, 1.0),
    SweepSettings(0.3, 0.0, 1.0),
)
#: repeated cyclically; over-relaxed (successive over-relaxation) after a first plain sweep
FINE = tuple(SweepSettings(1.0, slide, 1.5) for slide in (0.1, 0.0, 0.02, 0.0, 0.3, 0.0, 0.05, 0.0))
#: below this alpha, common errors do not converge slowly
MIN_COARSE_ALPHA = 3.0


class ImprovedWeights(NamedTuple):
    """A body with better weights, and Q at the start and after each sweep with full alpha."""

    body: Body
    energies: tuple[float, ...]


class PosedMeshes(NamedTuple):
    """A body, its poses stacked over F frames, and the registered meshes in these poses, metres."""

    body: Body
    poses: Pose
    targets: Float[Array, "F V 3"]


def improve_weights(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    metric: Conformance,
    *,
    sweeps: int = 10,
    tolerance: float = 1e-3,
    coarse: bool = True,
    influences: int | None = None,
) -> ImprovedWeights:
    """Improve the skinning weights of a body with fixed poses and rest vertices; Q never rises.

    **Arguments:** `poses` stacked over F frames; `targets` are the registered meshes, metres; `sweeps` is the
    most sweeps with full alpha, which end when two in a row lower Q by less than a share `tolerance` each, in
    the mean; `coarse` enables sweeps with less of alpha first; `influences` is the most bones per vertex of a
    linear skin (None: any number). A vertex that begins with more is reduced only if that lowers Q.

    **Raises:** `ValueError` for a skin that is neither swing-twist, linear nor rigid, and for targets with
    another number of frames or vertices.
    """
    return improve_shared_weights(
        [PosedMeshes(body, poses, targets)],
        metric,
        sweeps=sweeps,
        tolerance=tolerance,
        coarse=coarse,
        influences=influences,
    )


def improve_shared_weights(
    subjects: Sequence[PosedMeshes],
    metric: Conformance,
    *,
    sweeps: int = 10,
    tolerance: float = 1e-3,
    coarse: bool = True,
    influences: int | None = None,
) -> ImprovedWeights:
    """Improve the skinning weights that several bodies share, as `improve_weights`; Q is the sum over all subjects.

    The bodies have the same tree, skin and triangles, and rest vertices, joints and poses of their own. The result is the
    first body, with the weights of all.
    """
    for subject in subjects:
        _check(*subject)
    descent = _Descent(subjects, metric, influences)
    start, before = descent.rows, descent.energy()
    energies = [before]
    if coarse and float(metric.alpha) > MIN_COARSE_ALPHA:
        for turn in (*COARSE, *(fine._replace(relaxation=1.0) for fine in FINE[:2])):
            descent.sweep(turn)
        energies.append(descent.energy())
        if energies[1] > before:
            descent.reset(start)
            energies = [before]
    for number in range(len(energies), sweeps + 1):
        if not descent.stale.any():
            break
        descent.sweep(FINE[(number - 1) % len(FINE)])
        energies.append(descent.energy())
        if len(energies) > 2 and energies[-3] - energies[-1] < 2 * tolerance * energies[-1]:
            break
    return ImprovedWeights(descent.body(), tuple(energies))


class _Descent:
    """The state of the descent: weights in the format of their solver, and the error field."""

    def __init__(self, subjects: Sequence[PosedMeshes], metric: Conformance, influences: int | None):
        self._subjects, self._metric = subjects, metric
        self._body = subjects[0].body
        self._rest = _rest_of_frames(subjects)
        solvers = [_weight_solver(subject.body, subject.poses, influences) for subject in subjects]
        self._solver, rows, self._restore = solvers[0]
        if len(solvers) > 1:
            self._solver = _concatenate_frames([solver for solver, _, _ in solvers])
        self._colours = colour_vertices(metric)
        self._share, self._turns = 1.0, 0
        self.reset(rows)

    def reset(self, rows) -> None:
        """Set the weights, and mark all vertices for an update."""
        self.rows = rows
        skin = self._restore(rows)
        fields = [
            error_field(eqx.tree_at(lambda body: body.skin, body, skin), poses, targets, self._metric)
            for body, poses, targets in self._subjects
        ]
        self._field = ErrorField(*(jnp.concatenate(parts, -1) for parts in zip(*fields, strict=True)))
        self.stale = np.ones(len(self._body.vertices), bool)

    def body(self) -> Body:
        return eqx.tree_at(lambda body: body.skin, self._body, self._restore(self.rows))

    def energy(self) -> float:
        return float(field_energy(self._field, self._metric))

    def sweep(self, settings: SweepSettings) -> None:
        """Update the weights of all vertices that may change."""
        slides = self._solver.num_candidates > 1
        every = settings.alpha_share != self._share or (slides and settings.slide_length > 0)
        active = np.ones_like(self.stale) if every else self.stale
        bases = getattr(self.rows, "bases", None)
        # sorting vertices by base shares memory reads of its motion
        order = np.arange(len(active)) if bases is None else np.argsort(np.asarray(bases), kind="stable")
        self.rows, self._field, changed = sweep(
            self._solver,
            self.rows,
            self._field,
            self._rest,
            scale_alpha(self._metric, settings.alpha_share),
            make_blocks(self._colours, active, order),
            jnp.asarray(settings.slide_length, self._body.vertices.dtype),
            jnp.asarray(1.0 if slides else settings.relaxation, self._body.vertices.dtype),
            self._solver.num_candidates if settings.slide_length > 0 else len(STEPS),
            self._turns,
        )
        self.stale = within_two_rings(self._metric, np.asarray(changed))
        self._share, self._turns = settings.alpha_share, self._turns + NUM_NEIGHBOURS


def _rest_of_frames(subjects: Sequence[PosedMeshes]) -> Float[Array, "V 3 N"]:
    """Return the rest vertices of one body for all frames, or those of several bodies with one column for each frame."""
    if len(subjects) == 1:
        return subjects[0].body.vertices[..., None]
    rest = [
        jnp.repeat(body.vertices[..., None], len(poses.rotations), axis=-1) for body, poses, _ in subjects
    ]
    return jnp.concatenate(rest, -1)


def _concatenate_frames(solvers: list):
    """Concatenate the frames of several solvers of one tree: the last axis of all arrays of numbers."""
    return jax.tree.map(
        lambda first, *others: (
            jnp.concatenate([first, *others], -1) if jnp.issubdtype(first.dtype, jnp.floating) else first
        ),
        *solvers,
    )


def _weight_solver(body: Body, poses: Pose, influences: int | None):
    """Return the solver of the weights, the weights in its format, and the function back to a skin."""
    skin = body.skin
    if isinstance(skin, SwingTwistSkin):
        slides = make_swing_twist_weight_solver(body.skeleton, poses)
        return slides, skin_to_rows(slides, skin), functools.partial(rows_to_skin, slides)
    blends = make_linear_weight_solver(body.skeleton, poses, influences)
    if isinstance(skin, LinearSkin):
        return blends, skin.weights, LinearSkin
    if isinstance(skin, RigidSkin):
        return RigidWeightSolver(blends), skin.bones, RigidSkin
    raise ValueError(
        f"The body has a {type(skin).__name__}; expected a SwingTwistSkin, LinearSkin or RigidSkin."
    )


def _check(body: Body, poses: Pose, targets) -> None:
    frames = poses.rotations.shape[0]
    if targets.shape != (frames, len(body.vertices), 3):
        raise ValueError(
            f"The targets have shape {tuple(targets.shape)}; expected (frames, vertices, 3) with {frames} "
            f"frames and {len(body.vertices)} vertices."
        )
