"""Deviations of the coefficients and joints of a body model that was fitted to registered meshes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import check_fields, checked
from ...body.body import pose_body
from ...body.body_model import BodyModel, shape_from_template
from ...body.pose import Pose
from ...body.shape_modes import apply_modes
from ...observe.meshes import MeshSequence
from ..fit_meshes import check_mesh_sequence
from ..fit_model import ModelFit
from ..linearise import body_tangent, vertex_jacobian
from .region_covariance import (
    RegionEquations,
    coefficient_covariance,
    eliminate_pose,
    frame_sums,
    joint_derivatives,
    joint_distances,
    surface_regions,
    unstack_equations,
)


class ModelUncertainty(eqx.Module):
    """Standard deviations of a `ModelFit` over F meshes."""

    #: of the coefficients of each mesh, all equal for meshes of one person
    coefficients: Float[np.ndarray, "F K"]
    #: expected distances of the joints from the true ones, metres
    joints: Float[np.ndarray, "F J"]

    def __check_init__(self):
        check_fields(self)


@checked
def model_uncertainty(
    model: BodyModel, sequence: MeshSequence, fit: ModelFit, *, same_person: bool = True
) -> ModelUncertainty:
    """Compute how well registered meshes determine the coefficients and the joints of a fit.

    The deviations come from the distances of the vertices that the fit leaves. Errors of vertices may be alike within a region of
    the surface, such as those of registration, and are independent between 64 regions (`region_covariance`). A coefficient that the
    meshes do not determine has the deviation of people, one. Meshes that were not fitted have NaN.

    **Arguments:** `fit` of `fit_model` with the same model, meshes and `same_person`.

    **Raises:** `InputError` where the meshes have other vertices than the model.
    """
    check_mesh_sequence(model.template, sequence)
    frames, joints = _linearise(model, sequence, fit)
    count = len(model.template_coefficients)
    fitted = np.asarray(fit.converged)
    deviations = np.full((len(frames), count), np.nan)
    distances = np.full(joints.shape[:2], np.nan)
    groups = [np.flatnonzero(fitted)] if same_person else [np.array([k]) for k in np.flatnonzero(fitted)]
    for group in groups:
        reduced = [eliminate_pose(frames[k], count) for k in group]
        if not reduced:
            continue
        covariance = coefficient_covariance(reduced)
        deviations[group] = np.sqrt(np.diagonal(covariance))
        for k, own in zip(group, reduced, strict=True):
            distances[k] = joint_distances(joints[k], frames[k], own, covariance)
    if same_person and len(groups[0]):
        deviations[:] = deviations[groups[0][0]]
    return ModelUncertainty(deviations, distances)


def mesh_equations(model: BodyModel, sequence: MeshSequence, fit: ModelFit) -> dict[int, RegionEquations]:
    """Linearise the meshes that were fitted, by pose and coefficients, each by its number."""
    frames, _ = _linearise(model, sequence, fit)
    return {int(k): frames[k] for k in np.flatnonzero(np.asarray(fit.converged))}


def _linearise(
    model: BodyModel, sequence: MeshSequence, fit: ModelFit
) -> tuple[list[RegionEquations], np.ndarray]:
    changes = fit.coefficients - model.template_coefficients
    regions = jnp.asarray(surface_regions(model.template.vertices))
    positions = sequence.vertices.astype(model.template.vertices.dtype)
    sums, joints = _equations(model, fit.motion.poses, changes, positions, regions)
    return unstack_equations(sums), np.asarray(joints, float)


@eqx.filter_jit
def _equations(
    model: BodyModel,
    poses: Pose,
    changes: Float[Array, "F K"],
    positions: Float[Array, "F V 3"],
    regions: Int[Array, "V"],
):
    """Linearise all meshes: the sums of each (`frame_sums`), and derivatives of the joints `(F, J, 3, N)`."""
    dofs, count = model.template.skeleton.num_dofs, changes.shape[1]

    def of_mesh(frame):
        pose, own, place = frame
        body = shape_from_template(model, own)
        body_at = partial(apply_modes, body, model.modes)
        known = jnp.isfinite(place).all(1)
        posed = pose_body(body, pose)
        gaps = jnp.where(known[:, None], posed.vertices - place, 0.0)
        rows = jnp.where(
            known[:, None, None], vertex_jacobian(posed, body_tangent(body_at, body, count)), 0.0
        )
        return frame_sums(rows, gaps, regions), joint_derivatives(body_at, pose, dofs, count)

    with jax.default_matmul_precision("highest"):
        return jax.lax.map(of_mesh, (poses, changes, positions))
