"""Fit of a body's pose and shape to the surface of another body at rest."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body, Posed, pose_body, posed_vertices
from ...body.body_model import BodyModel
from ...body.decimate import decimate, reduce_body, reduce_model
from ...body.matching.plan import plan_retarget
from ...body.pose import Motion, Pose, rest_pose, shift_roots, stack_poses
from ...body.shape_modes import joint_modes
from ...body.skeleton import dof_layout
from ...energy.data.pairs import PairDistances, PointPairs
from ...energy.energy import AbstractEnergy, Sum
from ...energy.priors.reference_pose import PosePrior
from ...energy.stacked import NormalPrior, Stacked
from ...fit.alternate import anneal_problem
from ...fit.correspondence.find_pairs import Matching, find_pairs
from ...fit.correspondence.nearest_assignment import (
    AbstractAssignment,
    IndexedScan,
    NearestOnSurface,
    NearestVertex,
    make_mesh_scan,
)
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.sequences.unknowns import AbstractUnknown, ShapeCoefficients, Size, make_body, model_coefficients
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry import rotation
from ...geometry.mesh import vertex_areas, vertex_normals
from ..retargeting.retarget import retarget

#: height of the bodies for which the lengths of this module are, metres
HEIGHT = 1.75
#: standard deviation of distances, metres, and number of independent ones for which a surface counts
NOISE, EVIDENCE = 0.005, 300.0
#: standard deviations of joints from the first pose, radians, of joint centres of a body without coefficients, metres, and of the
#: logarithm of its size
POSE_DEVIATION, CENTRE_DEVIATION, SIZE_DEVIATION = 0.5, 0.03, 0.3
#: largest distances of pairs by rounds, metres: with nearest vertices, then with nearest points of the surfaces
COARSE, FINE = tuple(np.geomspace(0.3, 0.08, 12)), tuple(np.geomspace(0.08, 0.03, 8))
#: headings about the vertical from which bodies start whose joints do not match
HEADINGS = 4
#: number of vertices of both bodies in the fit
NUM_VERTICES = 3000
#: damping of the first step
DAMPING = 0.01


class RestSurface(NamedTuple):
    """A surface at rest: vertices, metres, and triangles with an area."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "T 3"]

    @property
    def normals(self) -> Float[np.ndarray, "V 3"]:
        return np.asarray(vertex_normals(self.vertices, self.faces))

    @property
    def size(self) -> float:
        """The longest side of its box, as a share of `HEIGHT`."""
        return float(np.ptp(self.vertices, axis=0).max()) / HEIGHT


class _RestFit(NamedTuple):
    """The constant part of a fit."""

    body: Body
    unknowns: dict[str, AbstractUnknown]
    priors: tuple[NormalPrior, ...]
    #: metres of the source for one metre at `HEIGHT`
    size: float


def fit_at_rest(target: BodyModel | Body, source: Body, surface: RestSurface) -> Float[np.ndarray, "W 3"]:
    """Fit the pose and the shape of a target to the `surface` of a source at rest; return the target's posed vertices, metres.

    The first pose has the directions of the source's bones, where the joints of both match; otherwise the target is at rest, in
    the best of some headings. A target without shape coefficients changes its size and its joint centres.
    """
    fit, whole = (_make_fit(one, surface.size) for one in (_reduced(target), target))
    coarse = _reduced_surface(surface)
    scan = make_mesh_scan(coarse.vertices, coarse.normals, coarse.faces)
    starts = [_problem(fit, pose, None).start(pose) for pose in _starts(fit.body, source, surface)]
    found = [_refine(fit, start, scan, COARSE, NearestVertex()) for start in starts]
    best = min(found, key=lambda one: _residual(fit, one, scan))
    best = _refine(fit, best, scan, FINE, NearestOnSurface())
    return np.asarray(_posed(whole, best).vertices, float)


def _reduced(target: BodyModel | Body) -> BodyModel | Body:
    """Reduce a target to the vertices of the fit, if its surface can be reduced so far."""
    try:
        if isinstance(target, BodyModel):
            return reduce_model(target, NUM_VERTICES)
        return reduce_body(target, NUM_VERTICES)
    except ValueError:
        return target


def _reduced_surface(surface: RestSurface) -> RestSurface:
    if len(surface.vertices) <= NUM_VERTICES:
        return surface
    try:
        return RestSurface(*decimate(surface.vertices, surface.faces, NUM_VERTICES))
    except ValueError:
        return surface


def _make_fit(target: BodyModel | Body, size: float) -> _RestFit:
    if isinstance(target, BodyModel):
        body, deviation = target.template, 1.0
        unknowns: dict[str, AbstractUnknown] = {"shape": model_coefficients(target)}
    else:
        body, deviation = target, CENTRE_DEVIATION * size
        unknowns = {"shape": ShapeCoefficients(joint_modes(target)), "size": Size()}
    deviations = {"shape": deviation, "size": SIZE_DEVIATION}
    dtype = body.vertices.dtype
    priors = tuple(
        NormalPrior(
            name,
            jnp.zeros(unknown.size(body), dtype),
            jnp.full(unknown.size(body), deviations[name], dtype),
        )
        for name, unknown in unknowns.items()
    )
    return _RestFit(body, unknowns, priors, size)


def _starts(target: Body, source: Body, surface: RestSurface) -> list[Pose]:
    """Make the first poses of the target, stacked over one frame, at the middle of the surface."""
    try:
        plan = plan_retarget(source.skeleton, target.skeleton)
        motion = stack_poses([rest_pose(source.skeleton)])
        poses = [retarget(motion, source.skeleton, target.skeleton, floor=0.0, plan=plan).poses]
    except ValueError:
        poses = [_rotated(target, 2 * np.pi * k / HEADINGS) for k in range(HEADINGS)]
    middle = _middle(surface.vertices, surface.faces)
    placed = []
    for pose in poses:
        vertices = np.asarray(posed_vertices(target, pose)[0], float)
        shift = middle - _middle(vertices, np.asarray(target.faces))
        placed.append(shift_roots(target.skeleton, pose, shift[None]))
    return placed


def _rotated(target: Body, heading: float) -> Pose:
    """Rotate a body at rest about the vertical, y."""
    pose, dtype = rest_pose(target.skeleton), target.vertices.dtype
    turn = rotation.about_axis(jnp.array([0.0, 1.0, 0.0], dtype), jnp.asarray(heading, dtype))
    roots = np.flatnonzero(np.array(target.skeleton.parents) < 0)
    turned = Pose(pose.translations, pose.rotations.at[roots].set(turn), pose.scale)
    return stack_poses([turned]).poses


def _middle(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]) -> Float[np.ndarray, "3"]:
    """Compute the centroid of a surface."""
    areas = vertex_areas(vertices, faces)
    return areas @ vertices / areas.sum()


def _refine(
    fit: _RestFit,
    start: SequenceEstimate,
    scan: IndexedScan,
    reaches: tuple[float, ...],
    assignment: AbstractAssignment,
) -> SequenceEstimate:
    """Take a step with new pairs for each of the largest distances."""

    def renew(y: SequenceEstimate, reach: float) -> SequenceProblem:
        return _problem(fit, start.poses, _pairs(fit, y, scan, reach, assignment))

    return anneal_problem(renew, start, LevenbergMarquardt(damping=DAMPING), reaches)


def _pairs(
    fit: _RestFit, y: SequenceEstimate, scan: IndexedScan, reach: float, assignment: AbstractAssignment
) -> PointPairs:
    posed = _posed(fit, y)
    matching = Matching(
        max_normal_angle=60.0,
        max_distance=reach * fit.size,
        charbonnier=0.2 * reach * fit.size,
        assignment=assignment,
    )
    vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
    return find_pairs(vertices, normals, np.asarray(fit.body.faces), scan, matching)


def _problem(fit: _RestFit, first: Pose, pairs: PointPairs | None) -> SequenceProblem:
    """Make the problem of one frame: pairs, and priors of the pose, about the `first` one, and of the shape."""
    skeleton, dtype = fit.body.skeleton, fit.body.vertices.dtype
    roots = np.array(skeleton.parents)[dof_layout(skeleton).joints] < 0
    deviations = jnp.asarray(np.where(roots, np.inf, POSE_DEVIATION), dtype)
    terms: tuple[AbstractEnergy, ...] = (PosePrior(Motion(first, 1.0)[0], deviations),)
    if pairs is not None:
        weight = EVIDENCE / ((NOISE * fit.size) ** 2 * jnp.sum(pairs.weights))
        scaled = eqx.tree_at(lambda p: p.weights, pairs, weight * pairs.weights)
        one = jax.tree.map(lambda x: (x.astype(dtype) if eqx.is_inexact_array(x) else x)[None], scaled)
        terms = (Stacked(PairDistances(one)), *terms)
    return SequenceProblem(fit.body, Sum(terms), jnp.zeros(1, dtype), fit.unknowns, shared=fit.priors)


def _posed(fit: _RestFit, y: SequenceEstimate) -> Posed:
    return pose_body(make_body(fit.body, fit.unknowns, y.values), Motion(y.poses, 1.0)[0])


def _residual(fit: _RestFit, y: SequenceEstimate, scan: IndexedScan) -> float:
    """Compute a number that falls with the number and the closeness of pairs."""
    return -float(jnp.sum(_pairs(fit, y, scan, COARSE[-1], NearestVertex()).weights))
