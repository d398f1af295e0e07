"""Rigid parts of surfaces that move, the tree between them, and its left and right."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.body.kinematics import forward_kinematics
from jaxcap.body.skeleton import make_skeleton
from jaxcap.geometry.procrustes import group_moments, nearest_rotation, rigid_errors, rigid_fit, rigid_motions
from jaxcap.learn.parts.agglomerate import agglomerate, merged_labels
from jaxcap.learn.parts.find_parts import find_parts
from jaxcap.learn.skeleton.joint_tree import find_joint_tree, pose_parts
from jaxcap.learn.skeleton.left_right_pairs import detect_left_right_pairs
from jaxcap.learn.skeleton.reference_mesh import choose_reference_mesh

_kinematics = jax.jit(jax.vmap(forward_kinematics, (None, 0)))


def tube(length: float, rings: int, around: int = 12, radius: float = 0.06):
    """An open tube along x, and its triangles."""
    angles = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.zeros(around), np.cos(angles), np.sin(angles)], 1)
    along = np.linspace(0, length, rings)
    vertices = (circle * radius)[None] + along[:, None, None] * np.array([1.0, 0, 0])
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    faces = np.concatenate([np.stack([a, b, a + around], -1), np.stack([b, b + around, a + around], -1)])
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def arm(rng, frames: int = 12, scale: float = 1.0):
    """A tube of three rigid pieces with joints at x = 0.4 and 0.7, in random poses; its true labels."""
    vertices, faces = tube(1.0, 41)
    joints = [np.array([0.4, 0, 0]), np.array([0.7, 0, 0])]
    labels = np.digitize(vertices[:, 0], [0.4, 0.7])
    meshes = np.empty((frames, len(vertices), 3))
    for frame in range(frames):
        turn, shift = Rotation.random(random_state=rng), rng.normal(size=3)
        for part in range(3):
            own = labels == part
            meshes[frame, own] = turn.apply(vertices[own]) + shift
            if part < 2:
                bend = Rotation.from_rotvec(rng.uniform(-0.9, 0.9, 3))
                shift = shift + turn.apply(joints[part] - bend.apply(joints[part]))
                turn = turn * bend
    return vertices * scale, faces, meshes * scale, labels, np.array(joints) * scale


def same_partition(a, b) -> bool:
    """Whether two labellings say the same but for the numbers."""
    pairs = {(int(i), int(j)) for i, j in zip(a, b, strict=True)}
    return len(pairs) == len(set(a.tolist())) == len(set(b.tolist()))


def test_rigid_fit_is_scipys_and_never_mirrors(rng):
    source = rng.normal(size=(30, 3))
    weights = rng.uniform(0.1, 1, 30)
    target = rng.normal(size=(30, 3)) + Rotation.random(random_state=rng).apply(source)
    rotation, translation = rigid_fit(source, target, weights)
    middles = [np.average(points, axis=0, weights=weights) for points in (source, target)]
    expected, _ = Rotation.align_vectors(target - middles[1], source - middles[0], weights)
    np.testing.assert_allclose(rotation, expected.as_matrix(), atol=1e-7)
    np.testing.assert_allclose(translation, middles[1] - rotation @ middles[0], atol=1e-9)
    for case in (source * [1, 1, 0], source * [1, 0, 0]):
        assert np.linalg.det(rigid_fit(case, case * [-1, 1, 1])[0]) == pytest.approx(1)
    assert np.linalg.det(nearest_rotation(-np.eye(3))) == pytest.approx(1)


def test_moments_add_up_to_the_error_of_the_union(rng):
    source, target = rng.normal(size=(20, 3)), rng.normal(size=(20, 4, 3))
    groups = np.stack([np.arange(20) < 8, np.arange(20) >= 8]).astype(float)
    apart = group_moments(groups, source, target)
    union = apart.at(0).plus(apart.at(1))
    rotations, translations = rigid_motions(union)
    posed = np.einsum("fab,vb->vfa", rotations, source) + translations
    assert rigid_errors(union) == pytest.approx(np.sum((posed - target) ** 2))
    for _ in range(20):
        turned = rotations @ Rotation.random(random_state=rng).as_matrix()
        shifts = target.mean(0) - np.einsum("fab,b->fa", turned, source.mean(0))
        other = np.einsum("fab,vb->vfa", turned, source) + shifts
        assert np.sum((other - target) ** 2) >= rigid_errors(union)


def test_merging_takes_the_cheapest_neighbours_and_keeps_the_true_total(rng):
    source = rng.normal(size=(60, 3))
    target = source[:, None] + 0.3 * rng.normal(size=(60, 3, 3))
    labels = np.repeat(np.arange(6), 10)
    groups = (labels == np.arange(6)[:, None]).astype(float)
    moments = group_moments(groups, source, target)
    ring = np.stack([np.arange(6), (np.arange(6) + 1) % 6], 1)
    merging = agglomerate(moments, ring)
    costs = [
        rigid_errors(moments.at(a).plus(moments.at(b))) - rigid_errors(moments.at([a, b])).sum()
        for a, b in ring
    ]
    assert merging.errors[4] - merging.errors[5] == pytest.approx(min(costs))
    for count in (1, 2, 4, 6):
        kept = merged_labels(merging, count)
        joined = (kept == np.arange(count)[:, None]) @ groups
        assert rigid_errors(group_moments(joined, source, target)).sum() == pytest.approx(
            merging.errors[count - 1]
        )


@pytest.mark.parametrize("scale", [0.01, 1.0])
def test_an_arm_of_rigid_pieces_is_found_exactly(rng, scale):
    vertices, faces, meshes, labels, joints = arm(rng, scale=scale)
    shuffled = rng.permutation(len(vertices))
    place = np.argsort(shuffled)
    parts = find_parts(meshes[:, shuffled], place[faces], rest=vertices[shuffled])
    assert parts.num_parts == 3
    assert same_partition(parts.labels, labels[shuffled])
    tree = find_joint_tree(parts, parts.rest, place[faces])
    # the middle piece is neither the longest nor at an end: joints hang on it, or the chain passes it
    found = np.asarray(tree.skeleton.centres)[1:]
    gaps = np.linalg.norm(found[:, None] - joints, axis=-1)
    np.testing.assert_allclose(gaps.min(0), 0, atol=1e-3 * scale)
    poses = pose_parts(tree.skeleton, tree.parts, parts.rest)
    moved = _kinematics(tree.skeleton, poses)
    bones = tree.parts.labels
    posed = np.einsum("fvab,vb->fva", np.asarray(moved.rotations)[:, bones], parts.rest)
    posed = posed + np.asarray(moved.translations)[:, bones]
    assert np.abs(posed - meshes[:, shuffled]).max() < 2e-3 * scale


def test_the_root_is_amid_the_surface_and_x_points_down_the_chain(rng):
    vertices, faces, meshes, labels, _ = arm(rng)
    parts = find_parts(meshes, faces, 3, vertices)
    tree = find_joint_tree(parts, parts.rest, faces)
    skeleton = tree.skeleton
    assert skeleton.kinds == ("free", "ball", "ball")
    # of 0.4, 0.3 and 0.3 the middle piece leaves the smallest rest on either side
    assert np.all(labels[tree.parts.labels == 0] == 1)
    assert skeleton.parents == (-1, 0, 0)
    axes = Rotation.from_quat(np.asarray(skeleton.orientations)[:, [1, 2, 3, 0]]).apply([1.0, 0, 0])
    for bone in (1, 2):
        away = parts.rest[tree.parts.labels == bone].mean(0) - np.asarray(skeleton.centres[bone])
        assert axes[bone] @ away / np.linalg.norm(away) > 0.999
    assert tree.areas.sum() == pytest.approx(1)


def test_pieces_without_common_edges_and_vertices_that_stand_twice_are_joined(rng):
    vertices, faces, meshes, labels, _ = arm(rng)
    # every piece gets its own vertices: triangles across a joint go, and one vertex stands alone
    whole = faces[(labels[faces] == labels[faces[:, :1]]).all(1)]
    doubled = np.concatenate([meshes, meshes[:, :1], meshes[:, -1:] + 0.01], axis=1)
    whole = np.where(whole == 0, len(vertices), whole)
    parts = find_parts(doubled, whole, 3)
    assert same_partition(parts.labels[: len(vertices)], labels)
    assert parts.labels[len(vertices)] == parts.labels[0]
    tree = find_joint_tree(parts, parts.rest, whole)
    ends = {frozenset((int(labels[np.flatnonzero(tree.parts.labels == j)[0]]), int(labels[np.flatnonzero(tree.parts.labels == p)[0]]))) for j, p in enumerate(tree.skeleton.parents) if p >= 0}  # fmt: skip
    assert ends == {frozenset((0, 1)), frozenset((1, 2))}


def test_the_mesh_to_start_from_is_the_one_amid_the_others(rng):
    vertices, faces = tube(1.0, 21)
    bends = np.array([1.2, 0.3, -0.6, 0.0, 0.7])
    upper = vertices[:, 0] > 0.5
    meshes = np.repeat(vertices[None], len(bends), 0)
    joint = np.array([0.5, 0, 0])
    for frame, bend in enumerate(bends):
        meshes[frame, upper] = Rotation.from_rotvec([0, 0, bend]).apply(vertices[upper] - joint) + joint
        meshes[frame] = Rotation.random(random_state=rng).apply(meshes[frame])
    assert choose_reference_mesh(meshes, faces) == 1


def test_pairs_are_siblings_alike_and_doubtful_ones_are_left():
    names = [str(i) for i in range(8)]
    parents = [-1, 0, 1, 0, 3, 0, 0, 6]
    centres = [
        [0, 0, 0],
        [0.2, 0, 0],
        [0.5, 0, 0],
        [-0.2, 0, 0],
        [-0.2, 0.3, 0],
        [0, 0.4, 0],
        [0, 0, 0.3],
        [0, 0, 0.9],
    ]
    skeleton = make_skeleton(names, parents, ["free"] + ["ball"] * 7, centres)
    areas = np.array([3, 1, 1, 1.1, 0.9, 0.8, 2, 2.0])
    assert detect_left_right_pairs(skeleton, areas).tolist() == [[1, 3], [2, 4]]
    # four legs alike have no certain partners
    four = make_skeleton(list("abcde"), [-1, 0, 0, 0, 0], ["free"] + ["ball"] * 4, [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])  # fmt: skip
    assert len(detect_left_right_pairs(four, np.ones(5))) == 0


def test_what_cannot_be_is_said(rng):
    vertices, faces, meshes, _, _ = arm(rng, frames=3)
    with pytest.raises(ValueError, match="at least two meshes"):
        find_parts(meshes[:1], faces)
    with pytest.raises(ValueError, match="parts is 5000; expected at most"):
        find_parts(meshes, faces, 5000, vertices)
    broken = meshes.copy()
    broken[1, 7] = np.nan
    with pytest.raises(ValueError, match="Mesh 1 has vertices that are not finite"):
        find_parts(broken, faces)
    # nothing moves: one part, and a skeleton of its root alone
    still = find_parts(np.repeat(meshes[:1], 3, 0), faces)
    assert still.num_parts == 1
    assert find_joint_tree(still, still.rest, faces).skeleton.parents == (-1,)


@pytest.mark.shared
@pytest.mark.slow
def test_limbs_of_a_captured_subject(shared):
    with np.load(shared / "data" / "meshes" / "crane.npz", allow_pickle=False) as file:
        meshes, faces = file["vertices"][::2], file["faces"]
    parts = find_parts(meshes, faces, 19)
    assert parts.error < 0.017
    tree = find_joint_tree(parts, parts.rest, faces)
    assert np.max(tree.skeleton.depths) >= 4
    assert len(detect_left_right_pairs(tree.skeleton, tree.areas)) >= 3
