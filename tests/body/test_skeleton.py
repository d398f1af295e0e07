"""The tree of joints against brute force, and what it refuses."""

import jax
import numpy as np
import pytest
from helpers import chain_skeleton

from jaxcap.body.pose import rest_pose
from jaxcap.body.skeleton import (
    KINDS,
    describe_rest_difference,
    dof_layout,
    has_same_joints,
    make_skeleton,
    rest_distance,
)
from jaxcap.stacking import device_array, put_rows, take_rows


def random_tree(rng, count: int):
    """Names, parents in arbitrary order, and centres; more than one root."""
    order = rng.permutation(count)
    parents = np.full(count, -1)
    for place in range(2, count):
        parents[order[place]] = order[rng.integers(0, place)]
    names = [f"joint{i}" for i in range(count)]
    return names, parents.tolist(), rng.normal(size=(count, 3))


def ancestors(parents, joint) -> list[int]:
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def test_joints_are_sorted_parents_first_and_keep_what_is_theirs(rng):
    names, parents, centres = random_tree(rng, 12)
    kinds = rng.choice(list(KINDS), 12).tolist()
    axes = rng.normal(size=(12, 2, 3))
    skeleton = make_skeleton(names, parents, kinds, centres, axes=axes)
    assert all(parent < joint for joint, parent in enumerate(skeleton.parents))
    assert sorted(skeleton.names) == sorted(names)
    for new, name in enumerate(skeleton.names):
        old = names.index(name)
        parent = skeleton.parents[new]
        assert (names[parents[old]] if parents[old] >= 0 else None) == (
            skeleton.names[parent] if parent >= 0 else None
        )
        assert skeleton.kinds[new] == kinds[old]
        np.testing.assert_allclose(skeleton.centres[new], centres[old])
        np.testing.assert_allclose(
            skeleton.axes[new], axes[old] / np.linalg.norm(axes[old], axis=1, keepdims=True), atol=1e-15
        )


def test_an_order_that_will_do_is_kept():
    names = ["a", "b", "c"]
    assert make_skeleton(names, [-1, 0, 0], ["ball"] * 3, np.zeros((3, 3))).names == tuple(names)


def test_levels_depths_and_descent_against_walking_up_the_tree(rng):
    names, parents, centres = random_tree(rng, 15)
    skeleton = make_skeleton(names, parents, ["ball"] * 15, centres)
    chains = [ancestors(skeleton.parents, joint) for joint in range(15)]
    assert skeleton.depths.tolist() == [len(chain) - 1 for chain in chains]
    assert sorted(joint for level in skeleton.levels for joint in level) == list(range(15))
    for depth, level in enumerate(skeleton.levels):
        assert all(len(chains[joint]) - 1 == depth for joint in level)
    expected = np.array([[above in chains[below] for below in range(15)] for above in range(15)])
    np.testing.assert_array_equal(skeleton.descendants, expected)


def test_layout_gives_every_number_one_place():
    skeleton = chain_skeleton()
    layout = dof_layout(skeleton)
    assert skeleton.num_dofs == len(layout.joints) == len(layout.names) == len(set(layout.names))
    used = np.concatenate([layout.translations.ravel(), layout.rotations.ravel()])
    used = used[used < skeleton.num_dofs]
    assert sorted(used.tolist()) == list(range(skeleton.num_dofs))
    for joint, kind in enumerate(skeleton.kinds):
        assert np.sum(layout.translations[joint] < skeleton.num_dofs) == KINDS[kind][0]
        assert np.sum(layout.rotations[joint] < skeleton.num_dofs) == KINDS[kind][1]
        assert np.sum(layout.joints == joint) == sum(KINDS[kind])
    assert layout.names[:4] == ("root.tx", "root.ty", "root.tz", "root.rx")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"parents": [2, 0, 1]}, "cycle: (a -> |b -> |c -> )+"),
        ({"parents": [-1, 1, 0]}, "cycle: b -> b"),
        ({"parents": [-1, 0, 7]}, "'c' has parent 7"),
        ({"parents": [-1, 0, -2]}, "'c' has parent -2"),
        ({"names": ["a", "b", "a"]}, "'a' occurs twice"),
        ({"kinds": ["free", "ball", "hinge"]}, "'c' has kind 'hinge'"),
        ({"centres": [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, "centre of joint 'b'"),
        ({"centres": np.zeros((2, 3))}, "2 centres"),
        ({"names": [], "parents": [], "kinds": [], "centres": np.zeros((0, 3))}, "at least one joint"),
    ],
)
def test_wrong_skeletons_end_in_a_sentence(change, sentence):
    good = {
        "names": ["a", "b", "c"],
        "parents": [-1, 0, 1],
        "kinds": ["free", "ball", "ball"],
        "centres": np.zeros((3, 3)),
    }
    make_skeleton(**good)
    with pytest.raises(ValueError, match=sentence):
        make_skeleton(**{**good, **change})


def test_an_unknown_name_lists_the_known_ones():
    skeleton = chain_skeleton()
    assert skeleton.index("elbow") == skeleton.names.index("elbow")
    with pytest.raises(KeyError, match="root, spine"):
        skeleton.index("tail")


def test_skeletons_are_alike_by_their_joints_and_apart_by_where_these_stand():
    one = make_skeleton(("hip", "knee"), (-1, 0), ("free", "revolute"), [[0.0, 0, 0], [0.0, -0.4, 0]])
    longer = make_skeleton(("hip", "knee"), (-1, 0), ("ball", "ball"), [[0.0, 0, 0], [0.0, -0.4, 0.03]])
    assert has_same_joints(one, longer)
    assert abs(rest_distance(one, longer) - 0.03) < 1e-12
    assert not has_same_joints(one, make_skeleton(("hip", "knee"), (-1, -1), ("free", "free"), one.centres))
    assert not has_same_joints(one, make_skeleton(("hip", "heel"), (-1, 0), ("free", "ball"), one.centres))


@pytest.mark.parametrize(
    ("arm", "hangs", "said"),
    [
        ([0.6, 0, 0], 1, None),
        # of another person, and a little lower
        ([0.5, -0.1, 0.0], 1, None),
        ([0.2, -0.4, 0.0], 1, "bone from 'shoulder' to 'hand' differs by 90 degrees in direction"),
        ([0.6, 0, 0], 0, "'hand' has parent shoulder, not hip"),
    ],
)
def test_poses_mean_the_same_where_bones_point_the_same_way(arm, hangs, said):
    """A joint as near as 2 mm to its parent points anywhere."""

    def person(near, hand, on):
        centres = [[0.0, 0, 0], [0.2, 0, 0], near, hand]
        names = ("hip", "shoulder", "strap", "hand")
        return make_skeleton(names, (-1, 0, 0, on), ("free", "ball", "ball", "ball"), centres)

    found = describe_rest_difference(person([0, 0.002, 0], [0.6, 0, 0], 1), person([0.002, 0, 0], arm, hangs))
    assert found is None if said is None else said in str(found)


def test_skeletons_and_rest_poses_compile_nothing(rng, caplog):
    names, parents, centres = random_tree(rng, 17)
    with jax.log_compiles(), caplog.at_level("WARNING"):
        pose = rest_pose(make_skeleton(names, parents, ["ball"] * 17, centres))
    assert "Compiling" not in caplog.text
    np.testing.assert_array_equal(pose.rotations, np.tile([1.0, 0.0, 0.0, 0.0], (17, 1)))


def test_arrays_of_known_numbers_are_copies():
    for _ in range(20):
        numbers = np.zeros(1000)
        made = device_array(numbers)
        numbers[:] = 1.0
        assert not np.asarray(made).any()


def test_rows_of_a_list_are_those_of_an_array_also_when_traced():
    numbers = jax.numpy.arange(4.0)
    for take in (lambda x: take_rows(x, [2, 0]), lambda x: take_rows(x, [])):
        np.testing.assert_array_equal(jax.jit(take)(numbers), take(numbers))


def test_replaced_rows_leave_the_others_and_the_array_itself():
    numbers = jax.numpy.arange(4.0)
    before = {"a": numbers, "b": jax.numpy.stack([numbers, -numbers], 1)}
    after = put_rows(before, np.array([2, 0]), take_rows(before, np.array([3, 3])))
    np.testing.assert_array_equal(after["a"], [3, 1, 3, 3])
    np.testing.assert_array_equal(after["b"][:, 1], [-3, -1, -3, -3])
    np.testing.assert_array_equal(before["a"], [0, 1, 2, 3])
