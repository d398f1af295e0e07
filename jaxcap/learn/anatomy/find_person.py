"""The human skeleton placed in one of several registered meshes of a person."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry.mesh import vertex_areas
from ...geometry.procrustes import group_moments, rigid_errors
from ...geometry.sampling import even_indices
from ...observe.meshes import MeshSequence
from ...rigging.envelopes import bone_distances, default_tails
from ...rigging.place_skeleton import UPRIGHT, place_human
from ...rigging.register_template import make_surface_samples
from ...rigging.template import load_template
from ..parts.surface_graph import membership

#: the fewest vertices of a mesh in which a person is looked for
MIN_VERTICES = 300
#: the most meshes that are tried, those most like the human at rest first
TRIES = 12
#: sampled points of a surface for its profile, and the most meshes that are compared
SAMPLES, FRAMES = 2000, 200
#: another axis than y is taken to point up if bodies are longer along it by this factor
UPRIGHT_RATIO = 1.15
#: the largest distance from the bones, as a share of the height, and the largest share of the vertices beyond it
MAX_DISTANCE, MAX_FAR_SHARE = 0.16, 0.005
#: error of the parts of a placed skeleton as rigid bodies over all meshes, root mean square, as a share of the height: below the
#: first one a skeleton is accepted at once (14 mm for a person), above the second one never (28 mm). People without clothes
#: have 12 mm, a man in clothes 20 mm, and a placement with a folded arm 25 mm and more
GOOD_PART_ERROR, MAX_PART_ERROR = 0.009, 0.018


class PlacedPerson(NamedTuple):
    """The human skeleton in one of the meshes."""

    #: the mesh as rest shape, with the joints and the weights of the human
    body: Body
    #: the index of this mesh
    frame: int


class NoPerson(NamedTuple):
    """The reason why no person was found, a clause without a full stop."""

    reason: str


def find_person(meshes: MeshSequence) -> PlacedPerson | NoPerson:
    """Place the human skeleton in the mesh in which it fits best (`place_human`).

    The skeleton can be placed in the mesh of an upright person with the arms off the body, so meshes that are like the human at
    rest are tried first (`likeliest_meshes`). It fits if no part of the surface is far from all bones (`far_share`), and the
    better, the more rigidly its parts move over all meshes (`part_error`).
    """
    shapes, faces = np.asarray(meshes.vertices, float), np.asarray(meshes.faces)
    if shapes.shape[1] < MIN_VERTICES:
        return NoPerson(f"{shapes.shape[1]} vertices are too few to recognise a person")
    up = up_axis(shapes)
    tried = likeliest_meshes(shapes, faces, up)[:TRIES].tolist()
    reason, best, least = "", None, MAX_PART_ERROR
    for frame in tried:
        try:
            placed = place_human(shapes[frame], faces, up)
        except InputError as error:
            reason = reason or str(error).partition(";")[0].rstrip(".")
            continue
        far, error = far_share(placed), part_error(placed, shapes)
        if far > MAX_FAR_SHARE:
            reason = f"{far:.1%} of the vertices are far from all bones of the skeleton that was placed"
        elif error > MAX_PART_ERROR:
            reason = f"parts of the placed skeleton do not move rigidly, but within {error:.1%} of the height"
        elif error < least:
            best, least = PlacedPerson(placed, frame), error
        if least <= GOOD_PART_ERROR:
            break
    if best is not None:
        return best
    return NoPerson(f"no person was recognised in the {len(tried)} likeliest meshes: {reason}")


def far_share(placed: Body) -> float:
    """Return the share of the vertices that are farther than `MAX_DISTANCE` from all bones of a placed skeleton."""
    centres = np.asarray(placed.skeleton.centres, float)
    distances, _ = bone_distances(np.asarray(placed.vertices, float), centres, default_tails(placed.skeleton))
    return float(np.mean(distances.min(1) > MAX_DISTANCE * joint_extent(placed.skeleton)))


def part_error(placed: Body, shapes: Float[np.ndarray, "F V 3"]) -> float:
    """Compute the error of the parts of a placed skeleton as rigid bodies in all meshes, root mean square, over the height."""
    vertices, count = np.asarray(placed.vertices, float), placed.skeleton.num_joints
    areas = vertex_areas(vertices, np.asarray(placed.faces))
    groups = membership(np.asarray(placed.skin.dominant_bones()), areas, count)
    moments = group_moments(groups, vertices, shapes.transpose(1, 0, 2))
    return float(np.sqrt(np.sum(rigid_errors(moments)) / (areas.sum() * len(shapes)))) / joint_extent(
        placed.skeleton
    )


def joint_extent(skeleton: Skeleton) -> float:
    """Return the extent of the joints of a placed skeleton at rest, in whichever pose it was placed, by the lengths of its
    bones: nine tenths of the height of a person."""
    template = load_template().body.skeleton
    rest, parents = np.asarray(template.centres, float), np.array(template.parents)
    placed, below = np.asarray(skeleton.centres, float), parents >= 0
    lengths = [np.linalg.norm(centres[below] - centres[parents[below]], axis=1) for centres in (placed, rest)]
    return float(lengths[0].sum() / lengths[1].sum() * np.ptp(rest, axis=0).max())


def likeliest_meshes(
    shapes: Float[np.ndarray, "F V 3"],
    faces: Int[np.ndarray, "T 3"],
    up: Literal["x", "y", "z"] = "y",
) -> Int[np.ndarray, "F"]:
    """Order meshes by their likeness to the human at rest, the most similar first.

    Two surfaces are compared by the distributions of the heights and of the distances from the vertical axis, in units of the
    root of their areas. At most `FRAMES` meshes are compared; the others are left out.
    """
    template = load_template().body
    rest = _profile(np.asarray(template.vertices, float), np.asarray(template.faces))
    frames = even_indices(len(shapes), FRAMES, nearest=True)
    turn = np.array(UPRIGHT[up])
    profiles = np.stack([_profile(shapes[frame] @ turn.T, faces) for frame in frames])
    return frames[np.argsort(np.abs(profiles - rest).mean(1), kind="stable")]


def up_axis(shapes: Float[np.ndarray, "F V 3"]) -> Literal["x", "y", "z"]:
    """Determine the axis that points up: y, or another one along which most meshes are clearly longer."""
    x, y, z = np.median(np.ptp(shapes, axis=1), axis=0)
    if x > UPRIGHT_RATIO * max(y, z):
        return "x"
    return "z" if z > UPRIGHT_RATIO * y else "y"


def _profile(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "N"]:
    """Return the sorted heights of points on a surface, and the sorted distances from the vertical axis."""
    points = make_surface_samples(vertices, faces, SAMPLES).points / np.sqrt(
        vertex_areas(vertices, faces).sum()
    )
    across = points[:, [0, 2]] - np.median(points[:, [0, 2]], axis=0)
    return np.concatenate(
        [np.sort(points[:, 1] - points[:, 1].min()), np.sort(np.linalg.norm(across, axis=1))]
    )
