"""Terms of motion, shape and symmetry as energies, against closed forms and central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, check_energy, random_pose
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.adapt.objective import temporal_energy
from jaxcap.adapt.shape.shape_prior import make_shape_prior, shape_energy
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.symmetry import find_left_right_pairs
from jaxcap.energy.data.laplacian import make_laplacian_shape

BODY = chain_body("linear")
SKELETON = BODY.skeleton
_posed = eqx.filter_jit(jc.pose_body)


def turned(pose: jc.Pose, joint: int, angle: float) -> jc.Pose:
    """With one joint at an angle about a slanting axis."""
    quaternion = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_quat()[[3, 0, 1, 2]]
    return eqx.tree_at(lambda p: p.rotations, pose, pose.rotations.at[joint].set(quaternion))


def test_slopes_against_central_differences(rng):
    poses = [random_pose(SKELETON, rng, 0.4) for _ in range(3)]
    mesh = np.asarray(BODY.vertices) + 0.02 * rng.normal(size=BODY.vertices.shape)
    check_energy(jc.energy.SecondDifference(poses[0], poses[1]), BODY, poses)
    check_energy(make_laplacian_shape(BODY, mesh), BODY, poses)


def test_a_steady_turn_has_no_second_difference_and_a_jerk_has_its_angle():
    rest = rest_pose(SKELETON)
    steady = jc.energy.SecondDifference(turned(rest, 2, 0.2), turned(rest, 2, 1.0))
    assert jc.energies(steady, _posed(BODY, turned(rest, 2, 0.6)))["SecondDifference"] < 1e-20
    off = jc.energies(steady, _posed(BODY, turned(rest, 2, 0.6 + 0.3)))["SecondDifference"]
    assert off == pytest.approx(0.3**2 / SKELETON.num_joints)


def test_frames_that_are_missing_are_time_that_passes():
    """An even turn has no second difference whatever is missing of it, and a parabola the same everywhere."""
    rest, times = rest_pose(SKELETON), np.array([0.0, 1.0, 4.0, 6.0])
    gaps = jnp.diff(jnp.asarray(times))
    for bend in (0.0, 0.02):
        poses = [turned(rest, 2, 0.1 * t + bend * t**2) for t in times]
        whole = float(temporal_energy(SKELETON, stack_poses(poses, 30.0).poses, gaps))
        assert whole == pytest.approx(bend**2 / SKELETON.num_joints, rel=1e-9, abs=1e-20)


def test_its_mean_over_frames_is_the_temporal_term(rng):
    poses = [random_pose(SKELETON, rng, 0.3) for _ in range(5)]
    each = [
        float(jc.energies(jc.energy.SecondDifference(before, after), _posed(BODY, here))["SecondDifference"])
        for before, here, after in zip(poses, poses[1:], poses[2:], strict=False)
    ]
    whole = float(temporal_energy(SKELETON, stack_poses(poses, 30.0).poses))
    assert whole == pytest.approx(np.mean(each))


def test_the_shape_term_is_the_mean_over_meshes(rng):
    poses = [random_pose(SKELETON, rng, 0.3) for _ in range(3)]
    meshes = np.stack([np.asarray(_posed(BODY, pose).vertices) for pose in poses])
    noisy = meshes + 0.01 * rng.normal(size=meshes.shape)
    terms = [make_laplacian_shape(BODY, mesh) for mesh in noisy]
    each = [
        float(jc.energies(term, _posed(BODY, pose))["LaplacianShape"])
        for term, pose in zip(terms, poses, strict=True)
    ]
    prior = make_shape_prior(BODY, stack_poses(poses, 30.0).poses, noisy)
    assert shape_energy(prior, BODY) == pytest.approx(np.mean(each), rel=1e-6)
    # where a mesh stands does not matter
    there = make_laplacian_shape(BODY, meshes[0] + np.array([1.0, -2.0, 3.0]))
    assert jc.energies(there, _posed(BODY, poses[0]))["LaplacianShape"] < 1e-20
    with pytest.raises(ValueError, match="register the mesh to the body"):
        make_laplacian_shape(BODY, meshes[0][:-1])


def test_bones_that_differ():
    body = jc.human(resolution="low", joints="tracking")
    pairs = find_left_right_pairs(body.skeleton)
    pose = rest_pose(body.skeleton)
    symmetry = jc.energy.BoneSymmetry(pairs)
    even = float(jc.energies(symmetry, _posed(body, pose))["BoneSymmetry"])
    foot, leg = (body.skeleton.index(name) for name in ("LeftFoot", "LeftLeg"))

    def value(shift):
        centres = body.skeleton.centres
        bone = centres[foot] - centres[leg]
        longer = centres.at[foot].add(shift * bone / jnp.linalg.norm(bone))
        other = eqx.tree_at(lambda b: b.skeleton.centres, body, longer)
        return jnp.sum(symmetry.residual(jc.pose_body(other, pose)) ** 2)

    assert even < 1e-8
    # the foot's own bone grows by as much; the toes' changes too, by its cosine at most
    assert 0.01**2 * 0.9 < float(value(0.01)) < 2.1 * 0.01**2
    step = 1e-4
    slope = (float(value(0.01 + step)) - float(value(0.01 - step))) / (2 * step)
    assert float(jax.grad(value)(0.01)) == pytest.approx(slope, rel=1e-3)
