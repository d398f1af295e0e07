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
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body
from ...body.pose import Pose
from ...body.skin import LinearSkin, RigidSkin, SwingTwistSkin
from ...geometry.laplacian import Conformance
from .coordinate_descent import error_field, field_energy, make_blocks, scale_alpha, sweep
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
    _check(body, poses, targets)
    descent = _Descent(body, poses, targets, metric, influences)
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

    def __init__(self, body: Body, poses: Pose, targets, metric: Conformance, influences: int | None):
        self._body, self._poses, self._targets, self._metric = body, poses, targets, metric
        self._solver, rows, self._restore = _weight_solver(body, poses, influences)
        self._colours = colour_vertices(metric)
        self._share, self._turns = 1.0, 0
        self.reset(rows)

    def reset(self, rows) -> None:
        """Set the weights, and mark all vertices for an update."""
        self.rows = rows
        self._field = error_field(self.body(), self._poses, self._targets, self._metric)
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
            self._body.vertices,
            scale_alpha(self._metric, settings.alpha_share),
            make_blocks(self._colours, active, order),
            jnp.asarray(settings.slide_length, self._body.vertices.dtype),
            jnp.asarray(1.0 if slides else settings.relaxation, self._body.vertices.dtype),
            self._solver.num_candidates if settings.slide_length > 0 else len(STEPS),
            self._turns,
        )
        self.stale = within_two_rings(self._metric, np.asarray(changed))
        self._share, self._turns = settings.alpha_share, self._turns + NUM_NEIGHBOURS


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
