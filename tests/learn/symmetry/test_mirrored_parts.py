"""Parts, joints and edits that mirror each other."""

import numpy as np
import pytest

import jaxcap as jc
from jaxcap.geometry.spanning_tree import spanning_tree
from jaxcap.learn.skeleton.symmetric_tree import symmetric_joint_costs
from jaxcap.learn.symmetry.judge_map import MapQuality
from jaxcap.learn.symmetry.mirrored_parts import middle_joints, mirror_joints, mirror_parts
from jaxcap.learn.symmetry.surface_symmetry import SurfaceSymmetry
from jaxcap.learn.symmetry.symmetric_partition import mirror_partition
from jaxcap.learn.symmetry.symmetric_skeleton import make_symmetric
from tests.learn.symmetry.made_animal import make_animal


@pytest.fixture(scope="module")
def animal():
    """The animal with its true symmetry."""
    rest, faces = make_animal()
    mirrored = np.argmin(np.linalg.norm((rest * [-1, 1, 1])[:, None] - rest, axis=-1), 1)
    sides = np.where(np.abs(rest[:, 0]) < 0.03, 0, np.sign(rest[:, 0])).astype(int)
    corners = np.repeat(mirrored[:, None], 3, 1)
    weights = np.repeat([[1.0, 0.0, 0.0]], len(rest), 0)
    quality = MapQuality(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    return rest, faces, SurfaceSymmetry(corners, weights, sides, quality)


def labels_of(rest: np.ndarray) -> np.ndarray:
    """Trunk, head, four legs: 0 to 5."""
    legs = (rest[:, 1] < 0.4) * (2 + 2 * (rest[:, 2] < 0) + (rest[:, 0] > 0))
    return np.where(legs > 0, legs, np.where(rest[:, 2] > 0.4, 1, 0))


def test_parts_and_joints_are_paired(animal):
    rest, _, symmetry = animal
    labels, parents = labels_of(rest), (-1, 0, 0, 0, 0, 0)
    areas = np.ones(len(rest))
    parts = mirror_parts(labels, areas, symmetry.mirrored, 6)
    np.testing.assert_array_equal(parts.partners, [0, 1, 3, 2, 5, 4])
    joints = mirror_joints(parts, parents)
    np.testing.assert_array_equal(joints.pairs, [[2, 3], [4, 5]])
    np.testing.assert_array_equal(middle_joints(joints, parents), [False, True, False, False, False, False])
    # a leg below another one is not the mirror of a leg below the trunk
    np.testing.assert_array_equal(mirror_joints(parts, (-1, 0, 0, 0, 0, 2)).pairs, [[2, 3]])
    # a leg in two parts is no pair with one in one part
    split = np.where((labels == 3) & (rest[:, 1] < 0.22), 6, labels)
    uneven = mirror_joints(mirror_parts(split, areas, symmetry.mirrored, 7), (*parents, 3))
    np.testing.assert_array_equal(uneven.pairs, [[4, 5]])


def test_partitions_of_one_side_are_mirrored(animal):
    rest, _, symmetry = animal
    labels = labels_of(rest)
    split = np.where((labels == 3) & (rest[:, 1] < 0.22), 6, labels)
    both = mirror_partition(split, symmetry, 1)
    assert both.max() + 1 == 8
    there = both[symmetry.mirrored]
    off = (both >= 0) & (there >= 0) & (symmetry.sides != 0)
    for part in range(8):
        images = np.unique(there[off & (both == part)], return_counts=True)
        assert images[1].max() > 0.95 * images[1].sum()
    neither = mirror_partition(split, symmetry, -1)
    assert neither.max() + 1 == 6
    # without vertices that reach across, the trunk and the head stay as they were
    np.testing.assert_array_equal(
        neither[labels < 2] == neither[np.flatnonzero(labels == 0)[0]], labels[labels < 2] == 0
    )


def test_skeletons_become_symmetric(animal):
    rest, faces, symmetry = animal
    labels = labels_of(rest)
    low = (rest[:, 1] < 0.22) & (labels > 1)
    labels = np.where(low, labels + 4, labels)
    centres = np.array(
        [[0, 0.6, 0], [0.04, 0.7, 0.4], [-0.1, 0.5, 0.3], [0.11, 0.5, 0.3], [-0.1, 0.5, -0.3], [0.1, 0.52, -0.3],
         [-0.11, 0.2, 0.3], [0.11, 0.24, 0.3], [-0.11, 0.2, -0.3], [0.11, 0.26, -0.3]]
    )  # fmt: skip
    names = ["root", *(f"joint{joint}" for joint in range(1, 10))]
    kinds = ["free"] + ["ball"] * 9
    parents = [-1, 0, 0, 0, 0, 0, 2, 3, 4, 5]
    skeleton = jc.make_skeleton(names, parents, kinds, centres)
    order = [names.index(name) for name in skeleton.names]
    labels = np.argsort(order)[labels]
    found = make_symmetric(skeleton, labels, rest, faces, symmetry)
    assert len(found.pairs) == 4
    moved = np.asarray(found.skeleton.centres, float)
    lengths = np.linalg.norm(moved - moved[np.array(skeleton.parents)], axis=1)
    below = [pair for pair in found.pairs if skeleton.parents[pair[0]] > 0]
    assert len(below) == 2
    for left, right in below:
        assert abs(lengths[left] - lengths[right]) < 1e-5
    # the neck was 40 mm off the middle
    assert abs(moved[skeleton.index("joint1"), 0]) < 0.004
    assert np.abs(moved - np.asarray(skeleton.centres, float)).max() < 0.05


def test_the_tree_of_a_symmetric_surface_is_symmetric():
    # pelvis and chest, two shoulders, head, and two arms; the cheapest tree hangs one shoulder below the other
    partners = np.array([0, 1, 3, 2, 4, 6, 5])
    pairs = np.array([[0, 1], [1, 2], [1, 3], [2, 3], [2, 4], [3, 4], [2, 5], [3, 6], [5, 6]])
    costs = np.array([9.0, 7.0, 7.5, 1.0, 2.0, 2.5, 3.0, 8.0, 0.5])
    areas = np.array([5.0, 6.0, 1.0, 1.0, 2.0, 1.0, 1.0])
    found = spanning_tree(symmetric_joint_costs(costs, pairs, partners, areas), pairs, 7)
    assert {tuple(pair) for pair in pairs[found].tolist()} == {(0, 1), (1, 2), (1, 3), (2, 4), (2, 5), (3, 6)}
    # without the joint of one side the tree still connects all parts
    fewer = np.delete(np.arange(9), 7)
    found = spanning_tree(symmetric_joint_costs(costs[fewer], pairs[fewer], partners, areas), pairs[fewer], 7)
    assert len(found) == 6
    # parts that nothing mirrors have the cheapest tree
    alone = np.full(7, -1)
    found = spanning_tree(symmetric_joint_costs(costs, pairs, alone, areas), pairs, 7)
    np.testing.assert_array_equal(np.sort(found), np.sort(spanning_tree(costs, pairs, 7)))
