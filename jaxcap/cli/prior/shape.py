"""`jaxcap prior learn --meshes`: the shape around every vertex, from registered meshes of a body."""

from collections.abc import Sequence

import jax
import numpy as np

from ...adapt.shape.shape_prior import ShapePrior, make_shape_prior, shape_energy
from ...body.body import Body
from ...body.people.sample import select_diverse_poses
from ...errors import InputError, user_message
from ...fit.fit_meshes import fit_meshes
from ...io.meshes.meshes import read_named_meshes
from ..console.console import say, warn
from ..fit import check_mesh_size, same_triangles

#: more meshes of one body add little, and a file grows with every one
MOST_MESHES = 30


def learn_shape(body: Body, meshes: Sequence[str], unit: str) -> ShapePrior:
    """Compute the Laplacian vectors of the meshes with the most different poses, at most `MOST_MESHES`, and
    print a line about them.

    **Raises:** `InputError` if a file is invalid, or the meshes are not of the body.
    """
    sequence, names = read_named_meshes(meshes, unit)
    check_mesh_size(body, sequence, meshes[0])
    try:
        fit = fit_meshes(body, sequence)
    except ValueError as error:
        raise InputError(f"{meshes[0]}: {user_message(error)}") from None
    if not same_triangles(np.asarray(body.faces), np.asarray(sequence.faces)):
        warn(f"{meshes[0]}: the triangles differ from those of the body; vertices are matched by their order")
    posed = np.asarray(fit.converged)
    for number in np.flatnonzero(~posed):
        warn(f"{names[number]}: no pose of the body fits this mesh; it is skipped")
    if not posed.any():
        raise InputError(
            f"{meshes[0]}: no pose of the body fits any of {len(names)} meshes; check their unit."
        )
    there = np.flatnonzero(posed)
    found = jax.tree.map(lambda a: a[there], fit.motion.poses)
    kept = there[select_diverse_poses(body.skeleton, found, MOST_MESHES)]
    poses = jax.tree.map(lambda a: a[kept], fit.motion.poses)
    prior = make_shape_prior(body, poses, np.asarray(sequence.vertices, float)[kept])
    off, shape_distance = (
        float(np.sqrt(np.mean(np.asarray(fit.rmse)[kept] ** 2))),
        shape_energy(prior, body) ** 0.5,
    )
    say(
        f"shape: {len(kept)} of {len(names)} meshes; RMS error of the body {1e3 * off:.2f} mm, "
        f"of its Laplacian vectors {1e3 * shape_distance:.2f} mm"
    )
    return prior
