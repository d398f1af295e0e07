"""Checks of the meshes of several people before one body is learned from them."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ...adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from ...body.body_model import BodyModel, shape_body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry.mesh import count_other_triangles, mesh_edges
from ...geometry.sampling import even_indices
from ...observe.meshes import MeshSequence
from ..anatomy.joint_evidence import MAX_SHIFT
from ..check_meshes import MAX_POSE_RATIO, check_meshes, relative_sizes, shows_motion

#: patches of a surface whose sizes are compared
NUM_PATCHES = 64
#: relative difference in size above which two meshes do not show one person
MIN_GAP = 0.05
#: rotation from the pose at rest above which a joint is bent, and range of it over the meshes from which these show its shape, degrees
MAX_BEND, MIN_BEND_RANGE = 60.0, 30.0


def check_people(
    people: Mapping[str, MeshSequence], names: Mapping[str, Sequence[str]] | None = None
) -> list[str]:
    """Check that one body can be learned from the meshes of several people; return warnings as `check_meshes` does.

    There are also warnings of people whose meshes differ by a rigid motion only, of people of very different sizes, and of names
    that seem to have meshes of several people.

    **Arguments:** `names` of the meshes of each person, for messages.

    **Raises:** `InputError` as `check_meshes` does, for fewer than two people, for meshes of several topologies, if no person
    has meshes in two poses, and for people in different units.
    """
    if len(people) < 2:
        who = f"one person, {next(iter(people))}," if people else "no person"
        raise InputError(
            f"learn_people: there is {who} in the meshes, and a shape space is of several; give meshes of at least two people, or "
            "learn one body (`learn_body`, or `jaxcap learn` without --people)."
        )
    first = next(iter(people))
    for name, meshes in people.items():
        _check_topology(name, meshes, first, people[first])
    if all(len(meshes) < 2 for meshes in people.values()):
        raise InputError(
            f"learn_people: each of the {len(people)} people has one mesh, which shows no motion; give several meshes, in poses that "
            "move every joint, of at least one of them."
        )
    called = {
        name: _numbered(name, meshes) if names is None else list(names[name])
        for name, meshes in people.items()
    }
    whole = MeshSequence(
        np.concatenate([np.asarray(meshes.vertices) for meshes in people.values()]), people[first].faces
    )
    owners = np.repeat(np.arange(len(people)), [len(meshes) for meshes in people.values()])
    messages = check_meshes(whole, [mesh for own in called.values() for mesh in own], owners)
    messages += _compare_sizes(people)
    for name, meshes in people.items():
        messages += [*_check_one_person(name, meshes, called[name]), *_check_motion(name, meshes)]
    return messages


def find_moving(people: Sequence[MeshSequence]) -> list[int]:
    """List the people whose meshes differ by more than a rigid motion."""
    return [n for n, meshes in enumerate(people) if shows_motion(np.asarray(meshes.vertices, float))]


def _check_topology(name: str, meshes: MeshSequence, first: str, others: MeshSequence) -> None:
    counts = [(each.vertices.shape[1], len(each.faces)) for each in (meshes, others)]
    same = counts[0] == counts[1] and not count_other_triangles(
        np.asarray(meshes.faces), np.asarray(others.faces)
    )
    if not same:
        raise InputError(
            f"learn_people: the meshes of {name} have {counts[0][0]} vertices and {counts[0][1]} triangles, and those of {first} "
            f"{counts[1][0]} and {counts[1][1]}{'' if counts[0] != counts[1] else ', which connect other vertices'}; all people "
            "need one topology; register them by `jaxcap register human SCANS -o registered.npz`."
        )


def _compare_sizes(people: Mapping[str, MeshSequence]) -> list[str]:
    """Compare the first mesh of each person with the median of all people."""
    shapes = np.stack([np.asarray(meshes.vertices[0], float) for meshes in people.values()])
    factors = relative_sizes(shapes, mesh_edges(np.asarray(next(iter(people.values())).faces)))
    return [
        f"{name} is {factor:.3g} times as large as the median of the people; check the unit of these meshes."
        for name, factor in zip(people, factors, strict=True)
        if abs(np.log(factor)) > np.log(MAX_POSE_RATIO)
    ]


def _check_one_person(name: str, meshes: MeshSequence, names: Sequence[str]) -> list[str]:
    groups = find_people_by_size(np.asarray(meshes.vertices, float), np.asarray(meshes.faces))
    if len(groups) == 1:
        return []
    few, usual = [str(names[mesh]) for mesh in groups[-1].tolist()], names[int(groups[0][0])]
    listed = ", ".join(few[:3]) + (f" and {len(few) - 3} more" if len(few) > 3 else "")
    return [
        f"The meshes of {name} may show several people: {listed} and {usual} differ by more than {MIN_GAP:.0%} in the "
        "size of most parts of the surface, which poses hardly change; give each person its own folder or file."
    ]


def _check_motion(name: str, meshes: MeshSequence) -> list[str]:
    if len(meshes) < 2 or find_moving([meshes]):
        return []
    return [
        f"The {len(meshes)} meshes of {name} differ by a rigid motion only, and show no more than one mesh: the joints of this person "
        "are estimated from the surface alone."
    ]


def find_people_by_size(
    shapes: Float[np.ndarray, "F V 3"], faces: Int[np.ndarray, "T 3"]
) -> list[Int[np.ndarray, "M"]]:
    """Group meshes by the size of the person that they show, the largest group first.

    Poses stretch the surface near joints, and hardly elsewhere. So the median over patches of the surface of the mean length of
    their edges, relative to other meshes, is that of the person: it changes by less than 0.5 % between motion-captured poses of made people,
    by 2 % for a man in clothes, and by 3 % between random poses. People of about the same size are one group.
    """
    logs = np.log(patch_sizes(shapes, faces))
    sizes = np.median(logs - logs.mean(0), axis=1)
    order = np.argsort(sizes)
    groups = np.split(order, np.flatnonzero(np.diff(sizes[order]) > MIN_GAP) + 1)
    return sorted((np.sort(group) for group in groups), key=len, reverse=True)


def patch_sizes(
    shapes: Float[np.ndarray, "F V 3"], faces: Int[np.ndarray, "T 3"]
) -> Float[np.ndarray, "F P"]:
    """Compute the mean length of the edges in patches of the surface, metres."""
    edges = mesh_edges(faces)
    seeds = shapes[0][even_indices(shapes.shape[1], NUM_PATCHES)]
    patches = KDTree(seeds).query(shapes[0][edges].mean(1))[1]
    counts = np.bincount(patches, minlength=len(seeds))
    sums = [
        np.bincount(patches, np.linalg.norm(mesh[edges[:, 0]] - mesh[edges[:, 1]], axis=1), len(seeds))
        for mesh in shapes
    ]
    used = counts > 0
    return np.stack(sums)[:, used] / counts[used]


def _numbered(name: str, meshes: MeshSequence) -> list[str]:
    return [f"mesh {number} of {name}" for number in range(len(meshes))]


def find_far_joints(
    model: BodyModel, coefficients: Float[np.ndarray, "N K"], names: Sequence[str]
) -> list[str]:
    """Return a sentence about each person with joints farther than `MAX_SHIFT` from where the surface has them.

    That is where the joints of the mean are, relative to the surface around them (`regress_joints`).
    """
    regressor, skeleton = make_joint_regressor(model.template), model.template.skeleton
    turning = [j for j, kind in enumerate(skeleton.kinds) if kind != "fixed" and skeleton.parents[j] >= 0]
    messages = []
    for name, row in zip(names, coefficients, strict=True):
        body = shape_body(model, row.astype(model.template.vertices.dtype))
        places = regress_joints(regressor, np.asarray(body.vertices, float))
        away = np.linalg.norm(places - np.asarray(body.skeleton.centres, float), axis=1)
        listed = ", ".join(
            f"{skeleton.names[j]} ({1000 * away[j]:.0f} mm)" for j in turning if away[j] > MAX_SHIFT
        )
        if listed:
            messages.append(
                f"The meshes of {name} moved joints far from where the surface has them: {listed}; give meshes that rotate them "
                "more, or `--skeleton human --fix-joints`."
            )
    return messages


def find_bent_joints(skeleton: Skeleton, motions: Sequence[Motion], names: Sequence[str]) -> list[str]:
    """Return a sentence about each person with joints that are bent by more than `MAX_BEND` in all meshes, and about as much.

    The meshes hardly show what is pose and what is shape there.
    """
    turning = [j for j, kind in enumerate(skeleton.kinds) if kind != "fixed" and skeleton.parents[j] >= 0]
    messages = []
    for name, motion in zip(names, motions, strict=True):
        cosines = np.clip(np.abs(np.asarray(motion.poses.rotations, float)[:, :, 0]), 0.0, 1.0)
        bends = 2 * np.degrees(np.arccos(cosines))
        least, alike = bends.min(0), np.ptp(bends, axis=0) < MIN_BEND_RANGE
        listed = ", ".join(
            f"{skeleton.names[j]} ({least[j]:.0f}°)" for j in turning if alike[j] and least[j] > MAX_BEND
        )
        if listed:
            messages.append(
                f"No mesh of {name} is near the pose at rest at the joints {listed}: the shape at rest is uncertain around them, and so "
                f"are the lengths of their bones; add a mesh of {name} in about that pose."
            )
    return messages
