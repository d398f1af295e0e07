"""A body of an animal is learned with its legs in pairs and its neck on the middle."""

import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from jaxcap.learn.parts.find_parts import MAX_SYMMETRY_COST, find_parts
from jaxcap.learn.symmetry.choose_symmetry import choose_symmetry, judge_motion
from jaxcap.observe.meshes import MeshSequence
from tests.learn.symmetry.made_animal import MIDDLE, make_animal, rotate_leg, turn_head

KNEE = 0.5
LEGS = ((0, -1), (0, 1), (1, -1), (1, 1))


def animal_meshes(knee_angle: float = 0.0) -> MeshSequence:
    """The animal in eight poses; the right front leg alone bends by up to some such angle at a knee."""
    rest, faces = make_animal(cell=0.045)
    rng = np.random.default_rng(0)
    shapes = []
    for angles in 0.5 * rng.normal(size=(8, 5)):
        shape = rotate_leg(turn_head(rest, angles[4]), 0, 1, knee_angle * rng.normal(), KNEE)
        for (leg, side), angle in zip(LEGS, angles[:4], strict=True):
            shape = rotate_leg(shape, leg, side, angle)
        shapes.append(shape)
    return MeshSequence(jnp.asarray(np.stack(shapes)), jnp.asarray(faces))


def test_legs_are_pairs_and_the_neck_is_on_the_middle():
    learned = jc.learn_body(animal_meshes(), skeleton="none", joints=5, rounds=1)
    assert "symmetry was found" in learned.symmetry_message
    assert learned.symmetry is not None
    skeleton = learned.body.skeleton
    assert skeleton.num_joints == 6
    assert len(learned.left_right_pairs) == 2
    centres = np.asarray(skeleton.centres)
    for left, right in learned.left_right_pairs:
        assert centres[left, 0] * centres[right, 0] < 0
        assert abs(centres[left, 2] - centres[right, 2]) < 0.1
    neck = ({*range(1, 6)} - set(learned.left_right_pairs.ravel().tolist())).pop()
    assert abs(centres[neck, 0]) < 0.01
    assert np.linalg.norm(centres[neck] - MIDDLE[1][0]) < 0.12


def test_sides_that_move_differently_have_parts_of_their_own():
    for angle, number, legs in ((0.0, 6, [1, 1]), (1.0, 8, [1, 2])):
        meshes = animal_meshes(angle)
        found = choose_symmetry(meshes)
        shapes, faces = np.asarray(meshes.vertices), np.asarray(meshes.faces)
        parts = find_parts(shapes, faces, number, symmetry=found.symmetry)
        judged = judge_motion(found, parts.symmetry_cost, MAX_SYMMETRY_COST)
        assert (judged.symmetry is not None) == (angle == 0)
        assert ("move differently" in judged.sentence) == (angle > 0)
        front = (parts.rest[:, 2] > 0.15) & (parts.rest[:, 1] < 0.4)
        sides = np.sign(parts.rest[:, 0])
        assert [len(np.unique(parts.labels[front & (sides == side)])) for side in (-1, 1)] == legs
    # the same parts in pairs, if they always have to be
    forced = find_parts(shapes, faces, number, symmetry=found.symmetry, max_symmetry_cost=np.inf)
    assert forced.symmetry_cost == parts.symmetry_cost
    assert forced.error > parts.error
    assert judge_motion(found, forced.symmetry_cost, np.inf) == found
