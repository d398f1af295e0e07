"""The human skeleton found again in people whose joints are known, and in a real capture."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.rigging.place_skeleton import UPRIGHT, place_human
from jaxcap.rigging.rig_mesh import rig_mesh
from jaxcap.rigging.template import (
    Person,
    average_build,
    build_body,
    load_template,
    pose_template,
    prior_deviations,
    retract_person,
)
from jaxcap.rigging.template_problem import TemplateProblem

ARMS = ("LeftArm", "LeftForeArm", "RightArm", "RightForeArm")
#: joints deep inside the trunk, which the surface shows least
TRUNK = ("Hips", "LHipJoint", "RHipJoint", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
TWIGS = ("Finger", "Thumb", "Toe")


def someone(rng, **options):
    """A person somewhere, turned about the vertical, arms moved by up to 15 degrees, the vertices
    shuffled. Returns `(vertices, faces, joints, names)`."""
    body = human(**options)
    rest = rest_pose(body.skeleton)
    axes = rng.normal(size=(len(ARMS), 3))
    axes *= np.radians(rng.uniform(5, 15, (len(ARMS), 1))) / np.linalg.norm(axes, axis=1, keepdims=True)
    arms = np.array([body.skeleton.index(name) for name in ARMS])
    turns = rest.rotations.at[arms].set(rotation.exp(jnp.asarray(axes)))
    turns = turns.at[0].set(rotation.exp(jnp.array([0.0, rng.uniform(0, 2 * np.pi), 0.0])))
    shift = rest.translations.at[0].set(jnp.array([1.3, 0.9, -0.4]))
    posed = pose_body(body, Pose(shift, turns, rest.scale))
    order = rng.permutation(len(body.vertices))
    faces = np.argsort(order)[np.asarray(body.faces)]
    return np.asarray(posed.vertices)[order], faces, np.asarray(posed.joints), body.skeleton.names


def test_a_build_stretches_bones_by_its_lengths_and_nothing_else():
    template = load_template()
    build = average_build(template)
    rest = build_body(template, build)
    np.testing.assert_allclose(rest.vertices, template.body.vertices, atol=1e-9)
    names = template.body.skeleton.names
    leg = names.index("LeftLeg")
    longer = eqx.tree_at(lambda b: b.lengths, build, build.lengths.at[template.groups[leg]].set(np.log(1.2)))
    longer = eqx.tree_at(lambda b: b.size, longer, jnp.log(2.0))
    stretched = build_body(template, longer)

    def bones(body):
        parents = np.array(body.skeleton.parents[1:])
        return np.linalg.norm(body.skeleton.centres[1:] - body.skeleton.centres[parents], axis=1)

    expected = 2.0 * bones(rest)
    shins = np.isin(names[1:], ["LeftFoot", "RightFoot"])
    np.testing.assert_allclose(bones(stretched), np.where(shins, 1.2, 1.0) * expected, atol=1e-6)
    weights = np.asarray(rest.skin.bone_weights(len(names)))
    head = weights[:, names.index("Head")] > 0.999
    np.testing.assert_allclose(
        stretched.vertices[head] - stretched.vertices[head][0],
        2.0 * (rest.vertices[head] - rest.vertices[head][0]),
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("options", "up"),
    [
        ({"sex": "female", "weight": 0.1}, "y"),
        ({"sex": "male", "weight": 0.95, "height": 1.86}, "z"),
    ],
    ids=["thin woman", "tall heavy man"],
)
def test_joints_are_found_in_people_of_another_build(rng, options, up):
    vertices, faces, joints, names = someone(rng, **options)
    turn = np.array(UPRIGHT[up])  # y = turn x, so the frame where `up` points up is back by its transpose
    body = place_human(vertices @ turn, faces, up)
    errors = np.linalg.norm(np.asarray(body.skeleton.centres) - joints @ turn, axis=1)
    trunk = np.isin(names, TRUNK)
    limbs = ~trunk & ~np.array([any(twig in name for twig in TWIGS) for name in names])
    assert errors[limbs].mean() < 0.010
    assert errors[trunk].mean() < 0.015
    assert errors.max() < 0.040
    # left and right follow from which way the feet point: a swap would put joints far off
    np.testing.assert_allclose(np.asarray(body.vertices), vertices @ turn)
    weights = np.asarray(body.skin.bone_weights(len(names)))
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    assert (weights > 0).sum(1).max() <= 4
    # at rest the body is the mesh as given
    rest = pose_body(body, rest_pose(body.skeleton))
    np.testing.assert_allclose(rest.vertices, vertices @ turn, atol=1e-9)


def test_a_mesh_that_is_no_person_is_told_with_its_distance():
    box = trimesh.creation.box((1.0, 1.7, 1.0)).subdivide_to_size(0.08)
    with pytest.raises(InputError, match=r"mean distance of \d+ mm"):
        place_human(np.array(box.vertices), np.array(box.faces))


def test_a_mesh_in_millimetres_is_told():
    body = human(resolution="low")
    with pytest.raises(InputError, match=r"1\d\d\d m tall along y.*millimetres"):
        place_human(1000 * np.asarray(body.vertices, float), np.asarray(body.faces))


@pytest.mark.shared
def test_the_skeleton_stands_inside_a_real_subject(shared):
    with np.load(shared / "data" / "meshes" / "crane.npz", allow_pickle=False) as file:
        vertices, faces = file["vertices"][0].astype(float), file["faces"]
    body = rig_mesh(vertices, faces)
    joints = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres), strict=True))
    inner = [name for name in joints if not any(twig in name for twig in TWIGS)]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    outside = trimesh.proximity.signed_distance(mesh, [joints[name] for name in inner]) < 0
    assert not outside.any(), [name for name, out in zip(inner, outside, strict=True) if out]
    # he looks along -x, so that his left is along +z
    assert joints["LeftToeBase"][0] < joints["LeftFoot"][0] - 0.05
    assert joints["LeftArm"][2] > joints["RightArm"][2] + 0.25


def test_the_template_is_drawn_by_the_squares_of_its_pairs(rng):
    template = load_template()
    spreads = jnp.asarray(prior_deviations(template))
    start = Person(average_build(template), rest_pose(template.body.skeleton))
    size, count = 0.1, len(template.body.vertices)
    places = np.asarray(pose_template(template, start).vertices)
    # two pairs for every vertex, each with its own metric
    roots, targets = rng.normal(size=(2, count, 3, 3)), places + 0.1 * rng.normal(size=(2, count, 3))
    metrics = 1e-2 * roots @ roots.swapaxes(-1, -2)
    gaps = targets - places
    pulls = np.einsum("nvab,nvb->va", metrics, gaps)
    worth = np.einsum("nva,nvab,nvb->", gaps, metrics, gaps)
    arrays = (places, metrics.sum(0), pulls, worth, size)
    problem = TemplateProblem(template, *(jnp.asarray(part) for part in arrays))

    def plain(d):
        person = retract_person(template, start, spreads * d)
        left = targets - np.asarray(pose_template(template, person).vertices)
        # the root is free; all else is held about rest and the expected size
        held = np.asarray(d).copy()
        held[:6], dofs = 0.0, template.body.skeleton.num_dofs
        held[dofs] -= size / spreads[dofs]
        return 0.5 * (np.einsum("nva,nvab,nvb->", left, metrics, left) + held @ held)

    info = jax.jit(lambda problem, start: problem.information(start))(problem, start)
    for _ in range(3):
        d = rng.normal(size=len(spreads))
        d *= 1e-3 / np.linalg.norm(d)
        there = retract_person(template, start, spreads * d)
        assert float(problem.value(there)) == pytest.approx(plain(d), rel=1e-12)
        slope = (plain(d) - plain(-d)) / 2
        assert float(info.grad @ d) == pytest.approx(slope, rel=1e-4)
