"""Better skinning weights by block coordinate descent (Adaptation, 3.2.2).

With everything else fixed, `Q = sum e . A e` of the errors `e = targets - posed` depends on one
vertex `v` as `a_vv |y_v - T_v|^2` and a constant, where

    y_v = T_v + (A e)_v / a_vv

is the place, frame by frame, at which the vertex would serve the surface best. So the choice of
its weights is a small problem of its own, its gain is exact, and vertices that do not meet in
`A` choose at once: a colour at a time. Vertices around which nothing has changed since they last
chose are left out.

One vertex at a time, cracks close at once, but what a whole limb shares creeps, by `1 / alpha` a
sweep. That part hardly feels the Laplacian, though, so the first sweeps are made with little of
`alpha` or none, where each vertex goes its own way, and the rest mends the cracks. Where this ends
above the start, as it may near the optimum, it is undone, and all sweeps are made with `alpha`.
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
from .coordinate_descent import error_field, field_energy, make_blocks, soften, sweep
from .graph_colouring import colour_vertices, within_two_rings
from .linear_weights import Parts, make_blends
from .swing_twist_weights import LENDERS, STEPS, make_slides, slide_rows, slide_skin


class Turn(NamedTuple):
    """How a sweep is made: the share of alpha, how far weights slide (zero: they move by
    Gauss-Newton only), and how far aims are stretched for linear skins."""

    share: float
    slide: float
    reach: float


COARSE = (Turn(0.0, 0.25, 1.0), Turn(0.0, 0.05, 1.0), Turn(0.05, 0.2, 1.0), Turn(0.3, 0.0, 1.0))
#: again and again; over-relaxed, as in successive over-relaxation, after a first plain sweep
FINE = tuple(Turn(1.0, slide, 1.5) for slide in (0.1, 0.0, 0.02, 0.0, 0.3, 0.0, 0.05, 0.0))
#: below this alpha there is nothing to creep
CREEPS = 3.0


class ImprovedWeights(NamedTuple):
    """A body with better weights, and Q at the start and after each sweep with all of alpha."""

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
    """Better weights for a body whose poses and rest vertices stay; Q never rises.

    **Arguments:** `poses` stacked over F frames; `targets` the registered meshes, metres; `sweeps`
    with all of alpha, at most: two in a row that lower Q by less than `tolerance` of it are the
    last; `coarse` whether sweeps with less of alpha come first; `influences` bones that may move
    one vertex of a linear skin, at most (None: any number). A vertex that starts with more is
    brought down only where that lowers Q.

    **Raises:** `ValueError` for a skin that is neither swing-twist, linear nor rigid, and for
    targets of another number of frames or vertices.
    """
    _check(body, poses, targets)
    descent = _Descent(body, poses, targets, metric, influences)
    start, before = descent.rows, descent.energy()
    energies = [before]
    if coarse and float(metric.alpha) > CREEPS:
        for turn in (*COARSE, *(fine._replace(reach=1.0) for fine in FINE[:2])):
            descent.sweep(turn)
        energies.append(descent.energy())
        if energies[1] > before:
            descent.begin(start)
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
    """Where the descent stands: weights in the form of their chooser, and the field of errors."""

    def __init__(self, body: Body, poses: Pose, targets, metric: Conformance, influences: int | None):
        self._body, self._poses, self._targets, self._metric = body, poses, targets, metric
        self._chooser, rows, self._restore = _chooser(body, poses, influences)
        self._colours = colour_vertices(metric)
        self._share, self._turns = 1.0, 0
        self.begin(rows)

    def begin(self, rows) -> None:
        """Stand at these weights, with all vertices still to choose."""
        self.rows = rows
        self._field = error_field(self.body(), self._poses, self._targets, self._metric)
        self.stale = np.ones(len(self._body.vertices), bool)

    def body(self) -> Body:
        return eqx.tree_at(lambda body: body.skin, self._body, self._restore(self.rows))

    def energy(self) -> float:
        return float(field_energy(self._field, self._metric))

    def sweep(self, turn: Turn) -> None:
        """Let all vertices choose that may have a reason to."""
        slides = self._chooser.num_candidates > 1
        every = turn.share != self._share or (slides and turn.slide > 0)
        active = np.ones_like(self.stale) if every else self.stale
        bases = getattr(self.rows, "bases", None)
        # vertices of one base side by side share what is read of its motion
        order = np.arange(len(active)) if bases is None else np.argsort(np.asarray(bases), kind="stable")
        self.rows, self._field, changed = sweep(
            self._chooser,
            self.rows,
            self._field,
            self._body.vertices,
            soften(self._metric, turn.share),
            make_blocks(self._colours, active, order),
            jnp.asarray(turn.slide, self._body.vertices.dtype),
            jnp.asarray(1.0 if slides else turn.reach, self._body.vertices.dtype),
            self._chooser.num_candidates if turn.slide > 0 else len(STEPS),
            self._turns,
        )
        self.stale = within_two_rings(self._metric, np.asarray(changed))
        self._share, self._turns = turn.share, self._turns + LENDERS


def _chooser(body: Body, poses: Pose, influences: int | None):
    """What chooses weights, the weights in its form, and the way back to a skin."""
    skin = body.skin
    if isinstance(skin, SwingTwistSkin):
        slides = make_slides(body.skeleton, poses)
        return slides, slide_rows(slides, skin), functools.partial(slide_skin, slides)
    blends = make_blends(body.skeleton, poses, influences)
    if isinstance(skin, LinearSkin):
        return blends, skin.weights, LinearSkin
    if isinstance(skin, RigidSkin):
        return Parts(blends), skin.bones, RigidSkin
    raise ValueError(
        f"The weights of a {type(skin).__name__} cannot be improved; give the body a SwingTwistSkin, "
        "a LinearSkin or a RigidSkin."
    )


def _check(body: Body, poses: Pose, targets) -> None:
    frames = poses.rotations.shape[0]
    if targets.shape != (frames, len(body.vertices), 3):
        raise ValueError(
            f"Targets of shape {tuple(targets.shape)} do not fit {frames} poses of a body of "
            f"{len(body.vertices)} vertices; give (frames, vertices, 3)."
        )
