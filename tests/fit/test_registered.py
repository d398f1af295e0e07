"""A body in registered meshes: the poses that made them, mesh by mesh."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import Body, pose_body, posed_vertices
from jaxcap.body.pose import Motion, stack_poses, take_poses
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import RigidSkin
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.errors import InputError
from jaxcap.fit.fit_meshes import _fit_all, fit_meshes, procrustes_poses
from jaxcap.observe.meshes import MeshSequence
from jaxcap.report.scores import score_meshes, total_scores

FRAMES = 3


@pytest.fixture(scope="module")
def scene():
    """A skinned chain of every kind of joint, four poses, and the meshes they make."""
    body, rng = chain_body(), np.random.default_rng(1)
    truth = stack_poses([random_pose(body.skeleton, rng, 0.4) for _ in range(FRAMES)], 24.0)
    return body, truth, np.asarray(posed_vertices(body, truth.poses))


def ball_chain() -> Body:
    """Three balls of vertices on a chain of ball joints, each vertex fixed to its bone."""
    rng = np.random.default_rng(2)
    skeleton = make_skeleton(
        list("abc"), [-1, 0, 1], ["free", "ball", "ball"], [[0, 0, 0], [0, 0.4, 0], [0, 0.8, 0]]
    )
    vertices = 0.1 * rng.normal(size=(60, 3)) + np.repeat(np.arange(3), 20)[:, None] * [0, 0.4, 0]
    return Body(
        skeleton, RigidSkin(jnp.repeat(jnp.arange(3), 20)), jnp.asarray(vertices), jnp.zeros((0, 3), int)
    )


def test_procrustes_alone_is_exact_for_rigid_limbs(rng):
    """Against SciPy's own alignment of each limb, and against the pose that made the meshes."""
    body = ball_chain()
    truth = stack_poses([random_pose(body.skeleton, rng, 0.9) for _ in range(4)])
    meshes = np.asarray(posed_vertices(body, truth.poses))
    found = procrustes_poses(body, MeshSequence(meshes, body.faces))
    gaps = np.abs(np.sum(np.asarray(found.rotations * truth.poses.rotations), -1))
    np.testing.assert_allclose(gaps, 1.0, atol=1e-9)
    np.testing.assert_allclose(found.translations, truth.poses.translations, atol=1e-5)
    noisy = meshes + 0.02 * rng.normal(size=meshes.shape)
    found = procrustes_poses(body, MeshSequence(noisy, body.faces))
    rest, limb = np.asarray(body.vertices)[:20], noisy[2, :20]
    best = Rotation.align_vectors(limb - limb.mean(0), rest - rest.mean(0))[0]
    w, x, y, z = np.asarray(found.rotations[2, 0])
    assert (Rotation.from_quat([x, y, z, w]) * best.inv()).magnitude() < 1e-4


@pytest.mark.parametrize("kind", ["fixed", "revolute"])
def test_a_bone_is_rotated_as_its_vertices_below_a_joint_that_is_not(kind):
    """In another shape the bone between is rotated as its joint, fixed or a hinge, does not allow."""
    plain = ball_chain()
    skeleton = make_skeleton(
        list("abc"), [-1, 0, 1], ["free", kind, "ball"], [[0, 0, 0], [0, 0.4, 0], [0, 0.8, 0]]
    )
    body = Body(skeleton, plain.skin, plain.vertices, plain.faces)
    turns = Rotation.from_rotvec([[0.0, 0.3, 0.2], [0.0, 0.5, -0.3], [0.7, 0.2, 0.1]])
    limbs = np.array(body.vertices).reshape(3, 20, 3)
    mesh = np.concatenate([turn.apply(limb) for turn, limb in zip(turns, limbs, strict=True)])
    found = procrustes_poses(body, MeshSequence(mesh[None], body.faces))
    posed = pose_body(body, Motion(found)[0])
    np.testing.assert_allclose(posed.transforms.rotations[2], turns[2].as_matrix(), atol=1e-4)


def test_a_limb_without_vertices_follows_its_parent(rng):
    body = ball_chain()
    body = eqx.tree_at(lambda b: b.skin, body, RigidSkin(jnp.minimum(body.skin.bones, 1)))
    truth = stack_poses([random_pose(body.skeleton, rng, 0.9) for _ in range(2)])
    fit = fit_meshes(body, MeshSequence(posed_vertices(body, truth.poses), body.faces))
    assert fit.converged.all()
    np.testing.assert_allclose(fit.rmse, 0.0, atol=1e-6)
    np.testing.assert_allclose(fit.motion.poses.rotations[:, 2], [[1, 0, 0, 0]] * 2, atol=1e-9)


def test_the_poses_that_made_the_meshes_are_found(scene):
    body, _, meshes = scene
    fit = fit_meshes(body, MeshSequence(meshes, body.faces, 24.0))
    assert fit.converged.all()
    assert fit.motion.rate == 24.0
    np.testing.assert_allclose(fit.rmse, 0.0, atol=1e-5)
    np.testing.assert_allclose(posed_vertices(body, fit.motion.poses), meshes, atol=1e-4)


def test_the_error_is_least_and_is_what_it_says(scene, rng):
    """With noise: the residual is that of the poses, below the noise itself, and no step lowers it."""
    body, truth, meshes = scene
    noisy = meshes + 0.01 * rng.normal(size=meshes.shape)
    fit = fit_meshes(body, MeshSequence(noisy, body.faces))
    gaps = np.asarray(posed_vertices(body, fit.motion.poses)) - noisy
    rmse = np.sqrt(np.mean(np.sum(gaps**2, 2), axis=1))
    np.testing.assert_allclose(fit.rmse, rmse, rtol=1e-9)
    assert (rmse < np.sqrt(np.mean(np.sum((meshes - noisy) ** 2, 2), axis=1))).all()
    again = fit_meshes(body, MeshSequence(noisy, body.faces), start=truth.poses)
    np.testing.assert_allclose(again.rmse, fit.rmse, rtol=1e-4)


def test_a_mesh_that_is_lost_takes_no_other_with_it(scene):
    """One without a single place, one with a gap of some vertices."""
    body, _, meshes = scene
    spoilt = meshes.copy()
    spoilt[0] = np.nan
    spoilt[2, ::5] = np.inf
    fit = fit_meshes(body, MeshSequence(spoilt, body.faces))
    np.testing.assert_array_equal(fit.converged, [False, True, True])
    assert np.isnan(fit.rmse[0])
    assert np.isfinite(fit.motion.poses.rotations).all() and np.isfinite(fit.motion.poses.translations).all()
    np.testing.assert_allclose(fit.rmse[1:], 0.0, atol=1e-5)
    scores = score_meshes(
        body, fit.motion, MeshSequence(spoilt, body.faces), ("a", "b", "c"), np.asarray(fit.converged)
    )
    assert [score.fitted for score in scores.meshes] == [False, True, False]
    assert scores.mean == scores.meshes[1].mean


def test_some_of_the_vertices_do(scene):
    body, truth, meshes = scene
    chosen = np.arange(0, meshes.shape[1], 2)
    wrong = meshes.copy()
    wrong[:, 1::2] += 0.3
    fit = fit_meshes(body, MeshSequence(wrong, body.faces), vertices=chosen, start=truth.poses)
    np.testing.assert_allclose(posed_vertices(body, fit.motion.poses), meshes, atol=1e-3)


def test_meshes_of_another_body_are_refused(scene):
    body, _, meshes = scene
    with pytest.raises(InputError, match=f"47 vertices; expected the {meshes.shape[1]} vertices of the body"):
        fit_meshes(body, MeshSequence(meshes[:, 1:], body.faces[:1]))
    with pytest.raises(InputError, match="no mesh"):
        fit_meshes(body, MeshSequence(meshes[:0], body.faces))


def test_every_length_compiles_once(scene):
    """A second fit of as many meshes traces nothing anew."""
    body, _, meshes = scene
    fit_meshes(body, MeshSequence(meshes, body.faces))
    before = _fit_all._cached._cache_size()
    fit_meshes(body, MeshSequence(meshes + 0.01, body.faces))
    assert _fit_all._cached._cache_size() == before


def test_scores_are_those_of_all_vertices_together(rng):
    """Means and deviations of the whole from those of its meshes, against NumPy on all distances; a body
    that stands a known way off a plane has that distance."""
    side = np.linspace(-1, 1, 5)
    grid = np.array([[x, y, 0.0] for x in side for y in side])
    faces = [[5 * i + j, 5 * i + j + 1, 5 * i + j + 5] for i in range(4) for j in range(4)]
    faces += [[5 * i + j + 1, 5 * i + j + 6, 5 * i + j + 5] for i in range(4) for j in range(4)]
    flat = Body(
        make_skeleton(["root"], [-1], ["free"], [[0, 0, 0]]),
        RigidSkin(jnp.zeros(25, int)),
        jnp.asarray(grid),
        jnp.asarray(faces),
    )
    heights = rng.uniform(0, 0.05, size=(2, 25))
    places = np.stack([grid, grid])
    places[..., 2] += heights
    places[1, :, 0] *= 0.9
    motion = stack_poses([random_pose(flat.skeleton, rng, 0.0)] * 2)
    scores = score_meshes(flat, motion, MeshSequence(places, flat.faces), ("a", "b"))
    assert scores.mean == pytest.approx(heights.mean(), abs=1e-9)
    assert scores.sd == pytest.approx(heights.std(), abs=1e-9)
    assert scores.meshes[0].worst == pytest.approx(heights[0].max(), abs=1e-9)
    shifts = np.stack([0 * grid[:, 0], 0.1 * grid[:, 0]])
    assert scores.rmse == pytest.approx(np.sqrt(np.mean(heights**2 + shifts**2)), abs=1e-9)
    assert np.isnan(total_scores(tuple(score._replace(fitted=False) for score in scores.meshes)).mean)


class HeightRoot(AbstractEnergy):
    """A square root that is NaN below the origin."""

    def residual(self, posed):
        return jnp.sqrt(posed.vertices[:, 1])


def test_a_term_that_is_not_finite_is_refused(scene):
    body, _, meshes = scene
    with pytest.raises(
        InputError, match=r"fit_meshes: the residual of HeightRoot is not finite in \d+ of \d+ rows"
    ):
        fit_meshes(body, MeshSequence(meshes - 5.0, body.faces), terms=[HeightRoot()])


def test_starts_are_one_for_each_mesh(scene):
    body, truth, meshes = scene
    sequence = MeshSequence(meshes, body.faces, 24.0)
    fit = fit_meshes(body, sequence, start=truth)
    np.testing.assert_allclose(fit.rmse, 0.0, atol=1e-5)
    # the residuals are roundings, and so is every further step
    assert fit.converged.all()
    for start, given in ((truth[0], "a single pose"), (take_poses(truth.poses, slice(0, 2)), "2 poses")):
        with pytest.raises(InputError, match=f"`start` is {given}; expected one for each of {FRAMES} meshes"):
            fit_meshes(body, sequence, start=start)
