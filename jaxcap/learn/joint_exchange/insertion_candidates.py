"""Candidate bones for insertion, and the gain of each."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body
from ...body.pose import Pose
from ...geometry.procrustes import group_moments, rigid_motions
from ..parts.surface_graph import SurfaceGraph, boundary_edges, cut_patches, make_surface_graph, membership
from ..skeleton.reparent import BoneMotions, bone_motions, reparent_new_bone
from .blend_fit import blend_grams, fit_blends, neighbouring_bones
from .insert_and_remove import Split

#: patches evaluated as seeds of a bone, and the number of seeds that are refined
PATCHES, SEEDS = 256, 12
#: the least number of vertices of a bone
MIN_VERTICES = 8
#: rounds that alternate between the motion of a new bone and its vertices
ROUNDS = 3
#: weight of the new bone from which a vertex determines its motion; weight from which a vertex counts at all
CORE, TOUCHED = 0.5, 0.1


class _Seed(NamedTuple):
    """A candidate bone: its motion, and the patches around it."""

    motion: BoneMotions
    patches: Int[np.ndarray, "N"]


class _Fit(NamedTuple):
    """The fit of a candidate bone to the vertices around it."""

    gain: float
    vertices: Int[np.ndarray, "C"]
    #: bone indices of the columns, the new one first
    columns: list[int]
    weights: Float[np.ndarray, "C K"]


class _Scene(NamedTuple):
    rest: Float[np.ndarray, "V 3"]
    #: (F, V, 3)
    targets: Float[np.ndarray, "F V 3"]
    bones: BoneMotions
    labels: Int[np.ndarray, "V"]
    neighbours: list[list[int]]
    surface: SurfaceGraph
    patches: Int[np.ndarray, "V"]
    #: (P, P) adjacency of patches, including each itself
    patch_adjacency: np.ndarray


def find_splits(
    body: Body,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    mirrored: Int[np.ndarray, "V"] | None = None,
) -> list[Split]:
    """Find the most useful new bones, not adjacent to each other, in order of gain.

    Every patch of the surface is evaluated as a new bone with the best rigid motion of its vertices. Nearby
    vertices are blended linearly from the new bone and the bones around by least squares over the simplex.
    The gain is the decrease of the residual against the bones around alone, the same measure as in
    `find_removals`. The best candidates are then refined: vertices with a large weight of the new bone
    determine its motion. A new bone is joined where its motion and that of another bone have a common point. With the
    `mirrored` vertex of each vertex, the mirror images of the best candidates are candidates, too.
    """
    scene = _scene(body, poses, targets)
    number = len(scene.patch_adjacency)
    if number < 2:
        return []
    motions = _motions(scene, membership(scene.patches, np.ones(len(scene.rest)), number))
    seeds = [
        _Seed(BoneMotions(motions.rotations[:, [p]], motions.translations[:, [p]]), np.flatnonzero(near))
        for p, near in enumerate(scene.patch_adjacency)
    ]
    fits = _fits(scene, seeds)
    chosen: list[int] = []
    for patch in np.argsort([-fit.gain for fit in fits]):
        if len(chosen) < SEEDS and not scene.patch_adjacency[patch, chosen].any():
            chosen.append(int(patch))
    if mirrored is not None:
        chosen += _mirror_patches(scene, chosen, mirrored)
    wide = scene.patch_adjacency @ scene.patch_adjacency
    seeds = [seeds[patch]._replace(patches=np.flatnonzero(wide[patch])) for patch in chosen]
    for _ in range(ROUNDS):
        fits = _fits(scene, seeds)
        seeds = [_update_seed(scene, seed, fit) for seed, fit in zip(seeds, fits, strict=True)]
    splits = [_split(body, scene, seed, fit) for seed, fit in zip(seeds, _fits(scene, seeds), strict=True)]
    return sorted((split for split in splits if split is not None), key=lambda split: -split.gain)


def _scene(body: Body, poses: Pose, targets) -> _Scene:
    rest, goals = np.asarray(body.vertices, float), np.asarray(targets, float)
    surface = make_surface_graph(rest, rest[None], np.asarray(body.faces))
    patches = cut_patches(surface, rest, max(1, min(PATCHES, len(rest) // MIN_VERTICES)))
    number = int(patches.max()) + 1
    touching = np.eye(number, dtype=bool)
    pairs = boundary_edges(surface, patches)[0]
    touching[pairs[:, 0], pairs[:, 1]] = touching[pairs[:, 1], pairs[:, 0]] = True
    bones, labels = bone_motions(body.skeleton, poses), np.asarray(body.skin.dominant_bones())
    return _Scene(rest, goals, bones, labels, neighbouring_bones(body), surface, patches, touching)


def _mirror_patches(scene: _Scene, chosen: list[int], mirrored: Int[np.ndarray, "V"]) -> list[int]:
    """List the mirror images of patches that are not adjacent to any of them."""
    images = [int(np.bincount(scene.patches[mirrored[scene.patches == patch]]).argmax()) for patch in chosen]
    return [image for image in dict.fromkeys(images) if not scene.patch_adjacency[image, chosen].any()]


def _motions(scene: _Scene, groups) -> BoneMotions:
    rotations, translations = rigid_motions(group_moments(groups, scene.rest, scene.targets.swapaxes(0, 1)))
    return BoneMotions(rotations.swapaxes(0, 1), translations.swapaxes(0, 1))


def _fits(scene: _Scene, seeds: list[_Seed]) -> list[_Fit]:
    """Fit all seeds at once."""
    count = scene.bones.rotations.shape[1]
    members = [np.flatnonzero(np.isin(scene.patches, seed.patches)) for seed in seeds]
    columns = []
    for vertices in members:
        owner = int(np.argmax(np.bincount(scene.labels[vertices])))
        columns.append([count, *sorted({owner, *scene.neighbours[owner], *scene.labels[vertices].tolist()})])
    width = -(-max(len(row) for row in columns) // 4) * 4
    grams = [
        blend_grams(
            _append_motion(scene.bones, seed.motion),
            row,
            scene.rest[vertices],
            scene.targets[:, vertices],
            width,
        )
        for seed, row, vertices in zip(seeds, columns, members, strict=True)
    ]
    owner = np.repeat(np.arange(len(seeds)), [len(vertices) for vertices in members])
    real = np.arange(width) < np.array([len(row) for row in columns])[owner, None]
    grams = np.concatenate(grams)
    whole, weights = fit_blends(grams, real)
    real[:, 0] = False
    lost, _ = fit_blends(grams, real)
    gains = np.bincount(owner, np.maximum(lost - whole, 0.0), len(seeds))
    return [
        _Fit(float(gain), vertices, row, weights[owner == number, : len(row)])
        for number, (gain, vertices, row) in enumerate(zip(gains, members, columns, strict=True))
    ]


def _append_motion(bones: BoneMotions, motion: BoneMotions) -> BoneMotions:
    both = zip(bones, motion, strict=True)
    return BoneMotions(*(np.concatenate(pair, 1) for pair in both))


def _update_seed(scene: _Scene, seed: _Seed, fit: _Fit) -> _Seed:
    """Update the motion of a seed from the vertices that are mostly its own."""
    core = fit.weights[:, 0] > CORE
    if core.sum() < MIN_VERTICES:
        return seed
    weights = np.zeros((1, len(scene.rest)))
    weights[0, fit.vertices[core]] = fit.weights[core, 0]
    return seed._replace(motion=_motions(scene, weights))


def _split(body: Body, scene: _Scene, seed: _Seed, fit: _Fit) -> Split | None:
    touched = fit.weights[:, 0] > TOUCHED
    core = fit.vertices[fit.weights[:, 0] > CORE]
    if len(core) < MIN_VERTICES:
        return None
    count = body.skeleton.num_joints
    shares = np.zeros((int(touched.sum()), count + 1))
    shares[:, fit.columns] = fit.weights[touched]
    labels = scene.labels.copy()
    labels[core] = count
    # independent of the joints, which may be wrong
    sizes = np.bincount(labels, minlength=count + 1)
    free = _motions(scene, membership(labels, np.ones(len(labels)), count + 1))
    bones = _append_motion(scene.bones, seed.motion)
    for field, solved in zip(bones, free, strict=True):
        field[:, sizes >= MIN_VERTICES] = solved[:, sizes >= MIN_VERTICES]
    hung = reparent_new_bone(body.skeleton, bones, labels, scene.surface, scene.rest)
    owner = int(np.argmax(np.bincount(scene.labels[core])))
    rotations, translations = (field[:, [owner, count]] for field in bones)
    return Split(owner, fit.gain, fit.vertices[touched], shares, rotations, translations, hung)
