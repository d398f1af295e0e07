"""Values that cannot be, at the door of public functions: a sentence that names the function and the argument."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.fit.correspondence.nearest_assignment import as_scan, make_scan
from jaxcap.observe import Scan
from jaxcap.value_checks import check_positive


@pytest.fixture(autouse=True)
def as_users_have_it():
    """Without the checks of annotations that the tests switch on, which users do not have."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


BODY = chain_body()
SKELETON = BODY.skeleton
J, V = SKELETON.num_joints, len(BODY.vertices)
POSE = jc.rest_pose(SKELETON)
POINTS = np.asarray(BODY.vertices, float)
CLOUD = jc.make_cloud(POINTS, POINTS)
NAN = float("nan")
CAMERA = jc.geometry.look_at((0.0, 1.0, 2.0), (0.0, 0.5, 0.0), 16, 16, 60.0)


def camera(**changes) -> jc.geometry.Camera:
    parts = {
        name: np.asarray(getattr(CAMERA, name))
        for name in ("rotation", "translation", "focal", "principal_point")
    }
    return jc.geometry.Camera(**{**parts, "width": 16, "height": 16, **changes})


def landmarks(**changes) -> jc.VertexLandmarks:
    parts = {"vertices": jnp.arange(3), "targets": BODY.vertices[:3], "weights": jnp.ones(3)}
    return jc.VertexLandmarks(**{**parts, **changes})


def solved(energy) -> jc.fit.Solution:
    return jc.solve(energy + jc.RestPrior(jnp.ones((J, 3))), BODY, POSE)


REFUSED = [
    (lambda: jc.fit.make_mixture_settings(outlier=1.5), "make_mixture_settings: `outlier` is 1.5; expected a share between 0 and 1"),
    (lambda: jc.fit.make_mixture_settings(candidates=0), "make_mixture_settings: `candidates` is 0; .* at least 1"),
    (lambda: jc.fit.make_mixture_settings(smallest_sigma=-1), "make_mixture_settings: `smallest_sigma` is -1; .* above 0 metres"),
    (lambda: jc.fit.make_mixture_settings(normal_threshold=60), "make_mixture_settings: `normal_threshold` is 60; .* from -1 to 1"),
    (lambda: jc.make_tracker(BODY, iterations=0), "make_tracker: `iterations` is 0; .* at least 1"),
    (lambda: jc.make_tracker(BODY, max_iterations=3), "make_tracker: `max_iterations` is 3; .* at least 4"),
    (lambda: jc.make_tracker(BODY, motion_deviation=(-0.05, 0.3)), "make_tracker: `motion_deviation` has -0.05;"),
    (lambda: jc.make_tracker(BODY, rest_deviation=NAN), "make_tracker: `rest_deviation` is nan;"),
    (lambda: jc.make_tracker(BODY, momentum=-1.0), "make_tracker: `momentum` is -1;"),
    (lambda: jc.make_tracker(BODY, sigma_growth=np.inf), "make_tracker: `sigma_growth` is inf;"),
    (lambda: jc.make_tracker(BODY, sigma_start=0.0), "make_tracker: `sigma_start` is 0;"),
    # when they are called, and not when the first frame is asked for
    (lambda: jc.fit.track_frames(jc.make_tracker(BODY), [CLOUD], sigma=-1.0), "track_frames: `sigma` is -1;"),
    (lambda: jc.fit.track_frames(jc.make_tracker(BODY), [CLOUD], sigma=100.0), "`sigma` is 100; .* at most 5 metres"),
    (lambda: jc.fit.track_frames(jc.make_tracker(BODY), [CLOUD], up=(0.0, 0.0, 0.0)), "track_frames: `up` is .0.0,"),
    (lambda: jc.track(BODY, [CLOUD], rate=-3.0), "track: `rate` is -3.0;"),
    (lambda: jc.initialise(jc.make_tracker(BODY), CLOUD, up=(0.0, NAN, 0.0)), "initialise: `up` is .0.0, nan"),
    (lambda: jc.initialise(jc.make_tracker(BODY), CLOUD, turns=0), "initialise: `turns` is 0;"),
    (lambda: jc.energy.make_floor(BODY, up=(0.0, 0.0, 0.0)), "make_floor: `up` is .0.0, 0.0, 0.0.; expected a direction"),
    (lambda: jc.energy.make_floor(BODY, deviation=0.0), "make_floor: `deviation` is 0;"),
    (lambda: jc.energy.make_floor(BODY, height=NAN), "make_floor: `height` is nan;"),
    (lambda: jc.RestPrior(jnp.zeros((J, 3))), "RestPrior: `deviations` has 0; .* above 0"),
    (lambda: jc.energy.PosePrior(POSE, -jnp.ones(SKELETON.num_dofs)), "PosePrior: `deviations` has -1;"),
    (lambda: solved(landmarks(weights=-jnp.ones(3))), "VertexLandmarks: `weights` has -1; .* at least 0"),
    (lambda: solved(landmarks(weights=jnp.full(3, jnp.nan))), "VertexLandmarks: `weights` has nan;"),
    (lambda: solved(landmarks(targets=jnp.full((3, 3), jnp.nan))), "VertexLandmarks: `targets` has NaN;"),
    (lambda: solved(jc.energy.joint_landmarks(jnp.full((J, 3), jnp.nan))), "JointLandmarks: `targets` has NaN;"),
    (lambda: jc.Body(SKELETON, BODY.skin, BODY.vertices, BODY.faces + V), f"Body: `faces` has vertex .* 0 to {V - 1}"),
    (lambda: jc.Body(SKELETON, jc.LinearSkin(jnp.zeros((V, J))), BODY.vertices, BODY.faces), "LinearSkin: `weights` of vertex 0 sum to 0;"),
    (lambda: jc.Motion(POSE), r"Motion: `poses` is one pose; .* stack_poses\(\[pose\]\)"),
    (lambda: camera(rotation=-np.eye(3)), "Camera: `rotation` is .* expected a rotation matrix"),
    (lambda: camera(rotation=2 * np.eye(3)), "Camera: `rotation` is .* expected a rotation matrix"),
    (lambda: camera(focal=np.array([-500.0, 500.0])), "Camera: `focal` has -500; .* above 0 pixels"),
    (lambda: camera(width=0), "Camera: `width` is 0; .* at least 1"),
    (lambda: jc.MeshSequence(np.zeros((2, 5, 3)), np.full((3, 3), 9)), "MeshSequence: `faces` has vertex 9, .* 0 to 4"),
    (lambda: jc.scanner.scan_frame(jc.scanner.Scanner(), [CAMERA], 1700 * POINTS, np.asarray(BODY.faces)), "scan_frame: `vertices` is .* millimetres"),
    (lambda: jc.scanner.scan_frame(jc.scanner.Scanner(), [CAMERA], POINTS, np.asarray(BODY.faces) + V), "scan_frame: `faces` has"),
    (lambda: jc.limits.learn_limits({}), "learn_limits: `samples` is empty;"),
    (lambda: jc.make_adapt_task(BODY, [CLOUD], settings=jc.adapt.AdaptSettings(num_frames=0)), "AdaptSettings: `num_frames` is 0;"),
    (lambda: jc.edit.IkOptions(max_steps=-1), "IkOptions: `max_steps` is -1;"),
    (lambda: jc.make_cloud(np.full((5, 3), 1e308)), "1e.308 m from the origin"),
    (lambda: jc.make_cloud(np.concatenate([POINTS, [[1e200, 0, 0]]])), "1e.200 m from the origin"),
    (lambda: jc.make_cloud(POINTS + [1e6, 0, 0]), "1e.06 m from the origin; expected at most 10000 m"),
    (lambda: jc.make_cloud(0.001 * POINTS), "wide; expected metres, at least 0.005"),
    (lambda: jc.make_cloud(np.zeros((5, 3), complex)), "make_cloud: `points` is a complex array .* real numbers"),
    # sentences of `ValueError` take the function that was called
    (lambda: jc.human(height=175), "human: The height of a human is 175.0 m;"),
    (lambda: jc.human(resolution=2), "human: A body cannot be reduced to 2 vertices"),
    (lambda: jc.body.reduce_body(BODY, -5), "reduce_body: A body cannot be reduced to -5 vertices"),
    (lambda: jc.make_skeleton([], [], [], np.zeros((0, 3))), "make_skeleton: A skeleton needs at least one joint"),
    (lambda: jc.stack_poses([]), "stack_poses: `poses` is empty;"),
    (lambda: jc.edit.make_constraints(BODY, [jc.edit.Constraint(V, (0.0, 0.0, 0.0))]), "make_constraints: There is a constraint on vertex"),
    (lambda: jc.limits.make_joint_ranges(SKELETON, {"knee": [(0, 1)]}), "make_joint_ranges: There is a range for joint 'knee'"),
    (lambda: jc.adapt_body(BODY), "adapt_body: `task` is a Body; expected an AdaptTask"),
    (lambda: jc.learn.make_joint_problem(BODY), "make_joint_problem: missing a required argument: 'targets'; expected arguments: body, targets,"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "said"), REFUSED, ids=[said[:40] for _, said in REFUSED])
def test_values_that_cannot_be_are_refused_in_one_sentence(call, said):
    with pytest.raises(InputError, match=said) as caught:
        call()
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_traced_values_and_free_ones_pass():
    """Under `jit` values are not known, and an infinite deviation leaves free what it is of."""
    made = jax.jit(
        lambda x: (jc.RestPrior(x * jnp.ones((J, 3))), landmarks(targets=x * jnp.ones((3, 3))), camera(focal=x * jnp.ones(2)))
    )(-1.0)  # fmt: skip
    assert float(made[0].deviations[0, 0]) == -1.0
    jax.jit(lambda x: check_positive("here", x=x))(-1.0)
    jax.vmap(lambda faces: jc.Body(SKELETON, BODY.skin, BODY.vertices, faces))(BODY.faces[None] + V)
    jc.RestPrior(jnp.full((J, 3), jnp.inf))
    jc.make_tracker(BODY, motion_deviation=(np.inf, np.inf))
    whole = jc.fit.make_mixture_settings(smallest_sigma=1, damping=0)
    assert whole.smallest_sigma.dtype == whole.damping.dtype == whole.outlier.dtype


def test_a_target_that_is_not_known_weighs_nothing():
    """NaN with a weight of zero: the same pose as with any number there, and finite derivatives."""
    known = landmarks(targets=BODY.vertices[:3] + 0.01, weights=jnp.array([1.0, 0.0, 1.0]))
    missing = eqx.tree_at(lambda e: e.targets, known, known.targets.at[1].set(jnp.nan))
    same, pose = solved(known).pose, solved(missing).pose
    jax.tree.map(np.testing.assert_array_equal, pose, same)

    def reached(weights):
        return jnp.sum(solved(eqx.tree_at(lambda e: e.weights, missing, weights)).pose.translations)

    assert np.isfinite(jax.grad(reached)(known.weights)).all()
    joints = jnp.full((J, 3), jnp.nan).at[0].set(0.1)
    assert np.isfinite(
        solved(jc.energy.joint_landmarks(joints, jnp.zeros(J).at[0].set(1.0))).pose.translations
    ).all()


def test_a_floor_takes_a_vertical_of_any_length():
    one, other = jc.energy.make_floor(BODY, 0.1), jc.energy.make_floor(BODY, 0.1, up=(0.0, 3.0, 0.0))
    np.testing.assert_array_equal(one.up, other.up)
    np.testing.assert_array_equal(one.vertices, other.vertices)


def test_units_too_near_to_tell_are_both_named():
    inches = 1.7 / 0.0254 * np.random.default_rng(0).random((100, 3))
    with pytest.raises(InputError, match="looks like centimetres or inches: multiply by 0.01 or 0.0254"):
        jc.make_cloud(inches)


@pytest.mark.parametrize(
    "run", [lambda t, c: jc.track(BODY, c, tracker=t), lambda t, c: list(jc.fit.track_frames(t, c))]
)
def test_clouds_are_checked_alike_in_streams(run):
    few = jc.make_cloud(POINTS[: SKELETON.num_dofs - 1], POINTS[: SKELETON.num_dofs - 1])
    with pytest.raises(InputError, match=f"cloud 0 has {SKELETON.num_dofs - 1} points, fewer than the"):
        run(jc.make_tracker(BODY), [few])


def test_scans_of_files_and_clouds_are_taken_alike():
    file = Scan("a", POINTS, POINTS, np.zeros((0, 3), int))
    wanted = make_scan(CLOUD)
    for given in (file, CLOUD, wanted):
        np.testing.assert_array_equal(as_scan(given).points, wanted.points)
    prior = jc.RestPrior(jnp.ones((J, 3)))
    fits = [
        jc.fit_pose(BODY, given, POSE, jc.adapt.PoseTerms(prior), steps=1) for given in (file, CLOUD, wanted)
    ]
    for fit in fits[:2]:
        jax.tree.map(np.testing.assert_array_equal, fit.pose, fits[2].pose)
    with pytest.raises(InputError, match="initialise: `cloud` is an? .*; expected a Cloud or a Scan"):
        jc.initialise(jc.make_tracker(BODY), POSE)


def test_a_sentence_is_told_of_the_outermost_function():
    """And without any function, where a file or the command line says what is wrong."""
    with pytest.raises(InputError) as caught:
        jc.human(resolution=2)
    assert caught.value.function == "human"
    assert re.match("A body cannot be reduced to 2 vertices", caught.value.message)
