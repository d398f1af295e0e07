"""One term of a user's own moves the result of every fit where it should."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of
from helpers import chain_body, check_energy, random_pose
from jaxtyping import Array, Float, Int

import jaxcap as jc
from jaxcap.adapt.adapt_round import adapt_round
from jaxcap.adapt.objective import PoseTerms
from jaxcap.adapt.poses.fit_frame import fit_pose
from jaxcap.adapt.poses.pair_cache import make_pair_cache
from jaxcap.adapt.task import AdaptSettings, AdaptState, Stage
from jaxcap.energy.data.floor import make_floor
from jaxcap.errors import InputError
from jaxcap.fit.correspondence.nearest_assignment import make_scan
from jaxcap.fit.fit_meshes import fit_meshes
from jaxcap.markers.calibration.calibrate import calibrate
from jaxcap.markers.motion.inverse_kinematics import solve_markers
from jaxcap.markers.motion.stream import make_streamer, stream_frame
from jaxcap.markers.subject import marker_positions
from jaxcap.observe.meshes import MeshSequence
from jaxcap.stacking import stack_trees
from jaxcap.tracking.track import track
from tests.markers_limb import moving, seen_by, truth

BODY = chain_body("linear", 10, 8)


class FeetOnFloor(jc.AbstractEnergy):
    """Penetration of the plane y = height by some vertices, in centimetres."""

    vertices: Int[Array, "C"]
    height: Float[Array, ""]

    def residual(self, posed: jc.body.Posed) -> Float[Array, "C"]:
        return jnp.minimum(posed.vertices[self.vertices, 1] - self.height, 0.0) / 0.01


EVERY = jnp.arange(len(BODY.vertices))
_posed = eqx.filter_jit(jc.pose_body)


def lowest(body, poses) -> float:
    return float(min(np.asarray(_posed(body, pose).vertices)[:, 1].min() for pose in poses))


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def test_the_floor_is_the_energy_in_closed_form(rng):
    pose = random_pose(BODY.skeleton, rng, 0.4)
    floor = make_floor(BODY, 0.02, (0.0, 0.6, 0.8))
    check_energy(floor, BODY, [pose])
    heights = np.asarray(_posed(BODY, pose).vertices)[np.asarray(floor.vertices)] @ [0.0, 0.6, 0.8]
    assert (heights < 0.02).any()
    assert (heights > 0.02).any()
    expected = np.minimum(heights - 0.02, 0.0) / 0.01
    np.testing.assert_allclose(floor.residual(_posed(BODY, pose)), expected, atol=1e-9)


def test_registered_meshes_are_kept_above_a_floor(rng):
    poses = stack_trees([random_pose(BODY.skeleton, rng, 0.2) for _ in range(2)])
    meshes = jnp.stack([_posed(BODY, pose).vertices for pose in jc.Motion(poses, 30.0)])
    sequence = MeshSequence(meshes, BODY.faces, 30.0)
    free = fit_meshes(BODY, sequence)
    height = jnp.asarray(lowest(BODY, free.motion) + 0.03)
    raised = fit_meshes(BODY, sequence, terms=[100.0 * FeetOnFloor(EVERY, height)])
    assert lowest(BODY, free.motion) < float(height) - 0.02
    assert lowest(BODY, raised.motion) > float(height) - 0.005


def test_tracking_adapting_and_proportions_keep_above_a_floor(scene):
    _, actor, poses, clouds = scene
    seen = [jc.make_cloud(*cloud) for cloud in clouds[:3]]
    height = jnp.asarray(lowest(actor, poses[:3]) + 0.03)
    term = FeetOnFloor(jnp.arange(len(actor.vertices)), height)
    free = track(actor, seen, poses[0], search=False)
    raised = track(actor, seen, poses[0], search=False, terms=[30.0 * term])
    assert lowest(actor, raised) > lowest(actor, free) + 0.01

    prior, scan = task_of(scene).prior, make_scan(seen[1])
    plain = fit_pose(actor, scan, poses[1], PoseTerms(prior), steps=4).pose
    own = FeetOnFloor(term.vertices, jnp.asarray(lowest(actor, [plain]) + 0.03))
    held = fit_pose(actor, scan, poses[1], PoseTerms(prior, user=100.0 * own), steps=4).pose
    assert lowest(actor, [held]) > lowest(actor, [plain]) + 0.01

    settings = AdaptSettings(num_frames=3, shape_weights=(1.0, 1.0))
    reached = []
    for terms in (None, 100.0 * term):
        task = task_of(scene, settings=settings, terms=terms)
        state = AdaptState(0, actor, 1.0, jc.stack_poses(poses, 10.0), chosen=(0, 1, 2), pose_weight=1e-6)
        after = adapt_round(task, state, make_pair_cache(task), Stage("adapt", 1, 2))
        reached.append(lowest(after.body, [after.motion[n] for n in state.chosen]))
    assert reached[1] > reached[0] + 0.005


def test_terms_that_do_not_fit_are_told(scene):
    _, actor, poses, clouds = scene
    term = FeetOnFloor(jnp.asarray([10_000]), jnp.asarray(0.0))
    cloud = jc.make_cloud(*clouds[0])
    with pytest.raises(InputError, match="10000"):
        track(actor, [cloud], poses[0], terms=[term])
    with pytest.raises(InputError, match="terms"):
        track(actor, [cloud], poses[0], tracker=jc.make_tracker(actor), terms=[make_floor(actor)])


def test_markers_are_kept_above_a_floor(rng):
    """Of a known subject, of one that is calibrated, and frame by frame."""
    subject, motion = truth(), moving(rng, 12)
    frames = seen_by(subject, motion, rng)
    plain = solve_markers(subject, frames)

    def lowest_of(subject, poses) -> np.ndarray:
        return np.asarray(jax.vmap(lambda pose: marker_positions(subject, pose))(poses))[..., 1].min(1)

    before = lowest_of(subject, plain.motion.poses)
    height = float(np.median(before))
    floor = FeetOnFloor(jnp.arange(subject.num_markers), jnp.asarray(height))
    after = lowest_of(subject, solve_markers(subject, frames, terms=[floor]).motion.poses)
    assert after.min() > before.min() + 0.002
    np.testing.assert_allclose(after[before > height + 0.01], before[before > height + 0.01], atol=2e-3)
    streamer, state = make_streamer(subject, terms=[floor])
    streamed = []
    for frame in range(12):
        state, pose = stream_frame(streamer, state, np.asarray(frames.positions)[frame])
        streamed.append(float(marker_positions(subject, pose)[:, 1].min()))
    # from the third frame on a limb may be raised in two ways, and a stream keeps the first one
    np.testing.assert_allclose(streamed[:2], after[:2], atol=2e-3)
    assert min(streamed) > before.min() + 0.002
    assert np.all(np.array(streamed) > before - 2e-3)
    found = calibrate(frames, subject, num_frames=12, skin=False, terms=[floor])
    assert lowest_of(found.subject, found.motion.poses).min() > before.min() + 0.002
    with pytest.raises(InputError, match="vertices"):
        solve_markers(subject, frames, terms=[make_floor(BODY)])


class Heights(jc.energy.AbstractVertexEnergy):
    """Heights of some vertices, with the closed form times `factor`, and `more` residuals too many."""

    vertices: Int[Array, "C"]
    factor: Float[Array, ""]
    more: int = eqx.field(static=True, default=0)

    def residual(self, posed):
        return jnp.append(posed.vertices[self.vertices, 1], jnp.zeros(self.more))

    def vertex_jacobian(self, posed):
        up = jnp.zeros((len(self.vertices), 1, 3)).at[:, :, 1].set(1.0)
        return self.vertices, self.factor * up


def test_a_wrong_closed_form_is_found(rng):
    pose = random_pose(BODY.skeleton, rng, 0.4)
    good, bad = (Heights(EVERY[:5], jnp.asarray(factor)) for factor in (1.0, 1.001))
    differences = jc.fit.check_jacobian(0.3 * good + FeetOnFloor(EVERY, jnp.asarray(0.1)), BODY, pose)
    assert set(differences) == {"Heights", "FeetOnFloor"}
    assert max(differences.values()) < 1e-12
    with pytest.raises(InputError, match="Heights: row . of its Jacobian is"):
        jc.fit.check_jacobian(bad, BODY, pose)
    with pytest.raises(InputError, match="Heights: row . of its Jacobian is nan"):
        jc.fit.check_jacobian(Heights(EVERY[:5], jnp.asarray(jnp.nan)), BODY, pose, tolerance=0.1)


def test_a_closed_form_of_another_length_is_told_before_the_first_step():
    longer = Heights(EVERY[:5], jnp.asarray(1.0), more=2)
    with pytest.raises(
        InputError, match=r"`vertex_jacobian` returns derivatives \(5, 1, 3\) of a residual of 7"
    ):
        jc.solve(longer, BODY, jc.rest_pose(BODY.skeleton))
