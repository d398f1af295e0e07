"""From raw markers to skeleton and motion, limb by limb."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.markers.local_technique import fit_local
from jaxcap.markers.segments.find_segments import find_partition
from jaxcap.markers.segments.segment_sets import make_segments
from jaxcap.markers.skeleton.lengths import estimate_bone_lengths, joint_trajectories
from jaxcap.markers.skeleton.segment_tree import find_segment_tree
from jaxcap.markers.subject import marker_positions
from jaxcap.observe.markers import make_markers
from tests.markers_scene import PUPPET, puppet

PARENTS = {frozenset((k, parent)) for k, (parent, _, _) in enumerate(PUPPET) if parent >= 0}


def taken(scene, places=None):
    places = scene.places if places is None else places
    return make_markers(places, [f"m{i}" for i in range(places.shape[1])], 100.0)


def edges(tree, owner):
    """Joined pairs of the puppet's segments."""
    whose = [int(owner[members[0]]) for members in tree.augmented.segments.members]
    return {frozenset((whose[k], whose[parent])) for k, parent in enumerate(tree.parents) if parent >= 0}


def predicted(fit):
    return np.asarray(jax.jit(jax.vmap(marker_positions, (None, 0)))(fit.subject, fit.motion.poses))


def test_exact_markers_give_the_puppet_again(rng):
    scene = puppet(rng, hinges={2: (0.0, 0.0, 1.0)})
    fit = fit_local(taken(scene))
    assert edges(fit.tree, scene.owner) == PARENTS
    assert fit.skeleton.kinds.count("revolute") == 1 and fit.skeleton.kinds.count("free") == 1
    np.testing.assert_allclose(predicted(fit), scene.places, atol=1e-6)
    places, known = joint_trajectories(fit.tree)
    for k, joint in enumerate(fit.joints):
        if joint is not None and joint.axis_in_parent is None:
            whose = max(int(scene.owner[fit.segments.members[s][0]]) for s in (k, joint.parent))
            assert known[:, k].all()
            np.testing.assert_allclose(places[:, k], scene.joints[:, whose], atol=1e-6)
    assert fit.messages == ()


def test_pairs_of_markers_come_by_their_frames_through_joints(rng):
    scene = puppet(rng, markers=4, swing=0.6)
    keep = np.ones(len(scene.owner), bool)
    # limbs keep two markers each
    for segment in (1, 2, 3, 4):
        keep[np.flatnonzero(scene.owner == segment)[2:]] = False
    places, owner = scene.places[:, keep], scene.owner[keep]
    seen = np.ones(places.shape[:2], bool)
    segments = make_segments([np.flatnonzero(owner == k) for k in range(6)], len(owner))
    tree = find_segment_tree(places, seen, segments)
    assert edges(tree, owner) == PARENTS
    found, _ = joint_trajectories(tree)
    for k in (1, 3):
        joint = k if tree.parents[k] == 0 else 0
        assert np.abs(found[:, joint] - scene.joints[:, k]).max() < 1e-4


def test_order_and_world_change_nothing(rng):
    scene = puppet(rng, noise=0.001)
    order = rng.permutation(len(scene.owner))
    turn = Rotation.random(random_state=1).as_matrix()
    one = fit_local(taken(scene))
    other = fit_local(taken(scene, scene.places[:, order] @ turn.T + [1.0, 2.0, -3.0]))
    bones = [
        sorted(
            np.linalg.norm(np.diff(np.asarray(f.skeleton.centres)[[j, p]], axis=0)).item()
            for j, p in enumerate(f.skeleton.parents)
            if p >= 0
        )
        for f in (one, other)
    ]
    np.testing.assert_allclose(bones[0], bones[1], atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(predicted(other) - (predicted(one)[:, order] @ turn.T + [1.0, 2.0, -3.0]), axis=-1),
        0,
        atol=1e-4,
    )


def test_a_template_says_what_is_joined(rng):
    scene = puppet(rng)
    segments = find_partition(scene.places, np.ones(scene.places.shape[:2], bool)).segments
    first = fit_local(taken(scene), segments)
    bones = {name: name for name in first.skeleton.names if name != "segment1"}
    fit = fit_local(taken(scene), segments, template=(first.skeleton, bones))
    # what is not in the template is told to hang on nothing
    assert any("not connected to the other markers" in sentence for sentence in fit.messages)
    with pytest.raises(ValueError, match="The template has no joint 'x'"):
        fit_local(taken(scene), segments, template=(first.skeleton, {"segment0": "x"}))


def test_lengths_agree_and_symmetry_makes_pairs_equal(rng):
    frames = 400
    joints = np.zeros((frames, 4, 3))
    directions = Rotation.from_rotvec(0.6 * rng.normal(size=(3 * frames, 3))).apply([0.3, 0.0, 0.0])
    for k in range(3):
        joints[:, k + 1] = joints[:, k] + directions[k * frames : (k + 1) * frames] * (1 + 0.1 * (k == 2))
    between = [(0, 1), (1, 2), (2, 3)]
    known = np.ones((frames, 4), bool)
    for method in ("mean", "least_squares", "global"):
        np.testing.assert_allclose(
            estimate_bone_lengths(joints, known, between, method), [0.3, 0.3, 0.33], atol=1e-9
        )
    noisy = joints + 0.004 * rng.normal(size=joints.shape)
    known[50:90, 2] = False
    found = estimate_bone_lengths(noisy, known, between, "global")
    np.testing.assert_allclose(found, [0.3, 0.3, 0.33], atol=1e-3)
    for method in ("mean", "global"):
        paired = estimate_bone_lengths(noisy, known, between, method, left_right_pairs=[(0, 2)])
        assert paired[0] == paired[2] and 0.3 < paired[0] < 0.33


def test_global_lengths_are_the_least_squares_over_all_poses(rng):
    """Against a general solver over lengths and every frame's joints."""
    from scipy.optimize import least_squares

    frames = 5
    steps = Rotation.random(3 * frames, random_state=5).apply([0.3, 0.0, 0.0]).reshape(frames, 3, 3)
    joints = np.concatenate([np.zeros((frames, 1, 3)), np.cumsum(steps, axis=1)], 1)
    joints = joints + 0.03 * rng.normal(size=joints.shape)
    between = [(0, 1), (1, 2), (2, 3)]
    found = estimate_bone_lengths(joints, np.ones((frames, 4), bool), between, "global")

    def residual(unknown):
        lengths, rest = unknown[:3], unknown[3:].reshape(frames, 4, 3)
        x = [rest[:, 0]]
        for k in range(3):
            x.append(
                x[-1] + lengths[k] * rest[:, k + 1] / np.linalg.norm(rest[:, k + 1], axis=1, keepdims=True)
            )
        return (np.stack(x, 1) - joints).ravel()

    start = np.concatenate(
        [found * 1.05, np.concatenate([joints[:, :1], np.diff(joints, axis=1)], 1).ravel()]
    )
    best = least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found, best.x[:3], atol=1e-6)


def test_what_cannot_be_fitted_is_said(rng):
    scene = puppet(rng, frames=80)
    with pytest.raises(ValueError, match="nothing moves"):
        fit_local(taken(scene, np.repeat(scene.places[:1], 20, 0)))
    with pytest.raises(ValueError, match="No marker is visible"):
        fit_local(taken(scene, np.full((9, 4, 3), np.nan)))
    with pytest.raises(ValueError, match="No markers move together"):
        fit_local(taken(scene, rng.normal(size=(60, 6, 3))), threshold=0.01)


def test_a_marker_never_seen_and_a_joint_that_hardly_turns_are_told(rng):
    scene = puppet(rng, noise=0.001, swing=0.5)
    places = scene.places.copy()
    places[:, 7] = np.nan
    # the forearm is split in two by the user, though nothing turns between the halves
    stiff = puppet(rng, noise=0.001, still=(2,))
    segments = make_segments([np.flatnonzero(stiff.owner == k) for k in range(6)], len(stiff.owner))
    fit = fit_local(taken(scene, places))
    assert any("'m7' is never visible" in sentence for sentence in fit.messages)
    assert fit.bones[7] == -1
    fit = fit_local(taken(stiff), segments)
    assert any(
        "rotates by" in sentence and "has a standard deviation of" in sentence for sentence in fit.messages
    )


def test_two_subjects_in_one_file_are_told(rng):
    one, other = puppet(rng), puppet(rng)
    both = np.concatenate([one.places, other.places + [1.5, 0.3, 0.0]], 1)
    fit = fit_local(taken(one, both))
    assert any("another subject" in sentence for sentence in fit.messages)
    assert fit.skeleton.num_joints == 6
    mine = {int(m) // 24 for m in np.flatnonzero(fit.bones >= 0)}
    assert len(mine) == 1


@pytest.mark.shared
def test_cmu_subject_from_41_markers_without_labels(shared):
    from jaxcap.io.registry import read_markers

    frames = read_markers(shared / "data" / "markers" / "cmu_02_05.c3d")
    names = [label.split(":")[-1] for label in frames.labels]
    fit = fit_local(frames)
    owner = {
        name: k for k, members in enumerate(fit.segments.members) for m in members for name in [names[m]]
    }
    parents = fit.tree.parents

    def joined(a, b):
        return parents[owner[a]] == owner[b] or parents[owner[b]] == owner[a]

    # markers at the knees move with both bones; those of the thighs are RTHI and LTHI
    for a, b in (("RFWT", "RTHI"), ("LFWT", "LTHI"), ("RTHI", "RSHN"), ("LTHI", "LSHN"), ("RSHN", "RTOE"), ("LSHN", "LTOE"),
                 ("C7", "RFHD"), ("RUPA", "RWRA"), ("LUPA", "LWRA"), ("T10", "RBWT")):  # fmt: skip
        assert joined(a, b), (a, b)
    away = np.linalg.norm(predicted(fit) - np.asarray(frames.positions), axis=-1)
    assert np.median(away[:, fit.bones >= 0]) < 0.03


@pytest.mark.shared
def test_medial_knee_marker_is_loose(shared):
    from jaxcap.io.registry import read_markers

    folder = shared / "data" / "markers"
    takes = [read_markers(folder / f"biobuddy_{name}.c3d") for name in ("static", "right_hip", "right_knee")]
    places = np.concatenate([np.asarray(take.positions, float) for take in takes])
    labels = takes[0].labels
    segments = find_partition(places, np.ones(places.shape[:2], bool)).segments
    assert segments.is_loose[labels.index("RMFE")]
    for names in (
        ("LASIS", "RASIS", "LPSIS", "RPSIS"),
        ("RTHI1", "RTHI2", "RTHI3"),
        ("RLEG1", "RLEG2", "RLEG3"),
    ):
        assert len({int(segments.marker_segments[labels.index(name)]) for name in names} - {-1}) == 1
