"""Wrong shapes, numbers and types at public classes and functions: a sentence that names the class and the field."""

import dataclasses
import inspect
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from helpers import chain_body
from jaxtyping import Array, Float, Int, PRNGKeyArray

import jaxcap as jc
from jaxcap.arguments import checked
from jaxcap.errors import InputError
from jaxcap.io.meshes.clouds import Scans
from jaxcap.tracking import advance


@pytest.fixture(autouse=True)
def as_users_have_it():
    """Without the checks of annotations that the tests switch on, which users do not have."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


BODY = chain_body()
J, V = BODY.skeleton.num_joints, len(BODY.vertices)
POSE = jc.rest_pose(BODY.skeleton)


def examples() -> list:
    """A right one of each public class that users make by its constructor."""
    numbers, three, one = jnp.arange(4), jnp.ones((4, 3)), jnp.ones(4)
    return [
        BODY,
        BODY.skeleton,
        POSE,
        jc.stack_poses([POSE, POSE], 25.0),
        jc.LinearSkin(jnp.ones((V, J))),
        jc.DualQuaternionSkin(jnp.ones((V, J))),
        jc.body.RigidSkin(jnp.zeros(V, int)),
        jc.SwingTwistSkin(jnp.zeros(V, int), jnp.ones((V, J)), jnp.ones((V, J))),
        jc.Cloud(three, three, one),
        jc.MeshSequence(jnp.ones((2, 4, 3)), jnp.array([[0, 1, 2]])),
        jc.MarkerFrames(jnp.ones((2, 4, 3)), jnp.ones((2, 4), bool), tuple("abcd")),
        jc.VertexLandmarks(numbers, three, one),
        jc.energy.BoneLandmarks(numbers, three, three, one),
        jc.JointLandmarks(jnp.ones((J, 3)), jnp.ones(J)),
        jc.PointToPoint(numbers, three, one),
        jc.PointToPlane(numbers, three, three, one),
        jc.RestPrior(jnp.ones((J, 3))),
        jc.energy.PosePrior(POSE, jnp.ones(BODY.skeleton.num_dofs)),
        jc.energy.SecondDifference(POSE, POSE),
        jc.JointLimits(jc.limits.make_joint_ranges(BODY.skeleton)),
        jc.limits.make_joint_ranges(BODY.skeleton),
        jc.limits.make_pose_boxes(BODY.skeleton.names, -np.ones((J, 3)), np.ones((J, 3))),
        jc.limits.EulerBoxes(numbers, jnp.ones((4, 4)), three, three),
        jc.geometry.look_at(np.ones(3), np.zeros(3), 32, 24, 60.0),
        jc.fit.make_mixture_settings(),
        jc.fit.GaussNewton(),
    ]


EXAMPLES = {type(example).__name__: example for example in examples()}


def fields_of(example) -> dict:
    return {field.name: getattr(example, field.name) for field in dataclasses.fields(example) if field.init}


def wrong_values(value):
    """What a new user might give in place of a value."""
    if hasattr(value, "shape"):
        yield "another number of dimensions", jnp.ones((2, *value.shape, 2), value.dtype)
        yield "a text", "text"
        yield "complex numbers", np.ones(value.shape, complex)
        if value.ndim:
            yield "None", None
        if jnp.issubdtype(value.dtype, jnp.floating):
            yield "truths", np.ones(value.shape, bool)
        else:
            yield "no whole numbers", np.full(value.shape, 0.5)
    elif isinstance(value, eqx.Module):
        yield "a number", 3.0
        yield "an array", jnp.ones(7)
    elif isinstance(value, tuple):
        yield "a number", 3.0
    elif isinstance(value, (float, int)):
        yield "a text", "text"
        yield "a list", (1.0,)


def cases():
    for name, example in EXAMPLES.items():
        for field, value in fields_of(example).items():
            for what, wrong in wrong_values(value):
                if not callable(value):
                    yield pytest.param(name, field, wrong, id=f"{name}-{field}-{what}")


@pytest.mark.parametrize(("name", "field", "wrong"), cases())
def test_constructors_name_class_and_field(name, field, wrong):
    example = EXAMPLES[name]
    with pytest.raises(InputError) as error:
        type(example)(**{**fields_of(example), field: wrong})
    # another field may be the one that no longer fits, but the class and one of its fields are named
    told = re.match(rf"{name}: `(\w+)` .*; expected .+\.$", str(error.value), re.DOTALL)
    assert told, str(error.value)
    assert told[1] in fields_of(example)


@pytest.mark.parametrize("name", EXAMPLES)
def test_lengths_that_differ(name):
    """Each array in turn one longer than the others of the class with the same length: refused, if it shares one."""
    example = EXAMPLES[name]
    given = fields_of(example)
    arrays = {field: value for field, value in given.items() if hasattr(value, "shape") and value.ndim}
    firsts = [value.shape[0] for value in arrays.values()]
    for field, value in arrays.items():
        if firsts.count(value.shape[0]) < 2 or name in ("Camera", "MeshSequence", "JointRanges"):
            continue
        longer = jnp.concatenate([value, value[:1]])
        with pytest.raises(InputError, match=f"^{name}: `"):
            type(example)(**{**given, field: longer})


@pytest.mark.parametrize("name", EXAMPLES)
def test_right_ones_are_made_also_where_they_are_traced(name):
    """Under `jit`, `vmap` and `grad`, of arrays of NumPy, and with arrays replaced by `tree_map`."""
    example = EXAMPLES[name]
    given = fields_of(example)
    arrays = {field: value for field, value in given.items() if hasattr(value, "shape")}
    static = {field: value for field, value in given.items() if field not in arrays}

    def make(arrays):
        return jax.tree.leaves(type(example)(**static, **arrays))

    jax.tree.map(lambda leaf: object(), example)
    if not arrays:
        return
    jax.eval_shape(make, arrays)
    jax.eval_shape(jax.vmap(make, axis_size=3, in_axes=None), arrays)
    jax.eval_shape(jax.vmap(make), jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), arrays))
    make({field: np.asarray(value) for field, value in arrays.items()})


def test_sentences_in_full():
    with pytest.raises(InputError) as error:
        jc.VertexLandmarks(jnp.arange(4), jnp.ones((3, 3)), jnp.ones(4))
    assert str(error.value) == (
        "VertexLandmarks: `targets` is a floating-point array of shape (3, 3); expected a floating-point "
        "array of shape (C, 3), where C is 4 as in `vertices`."
    )
    with pytest.raises(
        InputError, match=f"Body: `skin` has length {V + 1}; expected {V}, dimension V of `vertices`"
    ):
        jc.Body(BODY.skeleton, jc.LinearSkin(jnp.ones((V + 1, J))), BODY.vertices, BODY.faces)
    with pytest.raises(
        InputError, match=f"Body: `skin` has length {J + 1}; expected {J}, dimension J of `skeleton`"
    ):
        jc.Body(BODY.skeleton, jc.LinearSkin(jnp.ones((V, J + 1))), BODY.vertices, BODY.faces)
    with pytest.raises(
        InputError, match="MarkerFrames: `labels` has length 3; expected 4, dimension M of `positions`"
    ):
        jc.MarkerFrames(jnp.ones((2, 4, 3)), jnp.ones((2, 4), bool), tuple("abc"))
    with pytest.raises(
        InputError, match="Motion: `rate` is -30.0; expected a number of frames per second above 0"
    ):
        jc.Motion(jc.stack_poses([POSE]).poses, -30.0)
    with pytest.raises(InputError, match="pose_body: `body` is a Pose; expected a Body"):
        jc.pose_body(POSE, BODY)
    with pytest.raises(
        InputError, match="pose_body: missing a required argument: 'pose'; expected arguments: body, pose"
    ):
        jc.pose_body(BODY)
    with pytest.raises(
        InputError, match=f"retract: `pose` has {J + 1} joints; expected {J} as in `skeleton`"
    ):
        jc.retract(
            BODY.skeleton, jc.Pose(jnp.ones((J + 1, 3)), jnp.ones((J + 1, 4)), jnp.ones(())), jnp.zeros(3)
        )
    with pytest.raises(
        InputError, match="make_tracker: `terms` is 3; expected an AbstractEnergy or a sequence of"
    ):
        jc.make_tracker(BODY, None, 3)
    with pytest.raises(InputError, match="RestPrior: its residual cannot be evaluated for a body of"):
        jc.make_tracker(BODY, None, jc.RestPrior(jnp.ones((J + 1, 3))))
    with pytest.raises(InputError, match="stack_poses: `poses` is a Pose; expected a sequence of Pose"):
        jc.stack_poses(POSE)


#: functions whose arguments have no annotations, take anything that can become an array, or have names that only a model
#: knows, and check it themselves
_OWN = {"make_segments", "shape_space_like", "shape_body"}


def functions():
    for space in (jc, *(found for name in jc.__all__ if hasattr(found := getattr(jc, name), "__path__"))):
        for name in space.__all__:
            function = getattr(space, name)
            if callable(function) and not inspect.isclass(function):
                yield name, function


@pytest.mark.parametrize(
    "function", [pytest.param(function, id=name) for name, function in functions() if name not in _OWN]
)
def test_functions_name_themselves_and_the_argument(function):
    """Every required argument of every public function replaced by an object that nothing can take."""
    required = [
        parameter.name
        for parameter in inspect.signature(function).parameters.values()
        if parameter.default is parameter.empty
    ]
    if required:
        with pytest.raises(InputError) as error:
            function(**dict.fromkeys(required, object()))
        told = re.match(rf"{function.__name__}: `(\w+)` is an object; expected ", str(error.value))
        assert told, str(error.value)
        assert told[1] in required
    with pytest.raises(InputError, match=f"^{function.__name__}: .*no_such_argument.*; expected arguments: "):
        function(**dict.fromkeys(required, object()), no_such_argument=1)


class Broken(jc.AbstractEnergy):
    """An energy of a user whose arrays do not broadcast."""

    targets: Float[Array, "N 3"]

    def residual(self, posed):
        return (posed.vertices - self.targets).reshape(-1)


class Marked(jc.AbstractEnergy):
    vertices: Int[Array, "C"]

    def residual(self, posed):
        return posed.vertices[self.vertices].reshape(-1)


@pytest.mark.parametrize(
    "function", [jc.solve, jc.uncertainty, lambda e, b, p: jc.fit.solve_in_order([e], b, p)]
)
def test_energies_that_do_not_fit_the_body(function):
    right = jc.RestPrior(jnp.ones((J, 3)))
    with pytest.raises(
        InputError,
        match=r"Broken: its residual cannot be evaluated for a body of .* `targets` is .* \(2, 3\)",
    ):
        function(right + 2.0 * Broken(jnp.ones((2, 3))), BODY, POSE)
    with pytest.raises(
        InputError, match=f"JointLandmarks: its residual .* body of {J} joints .* shape \\({J + 1}, 3\\)"
    ):
        function(jc.energy.joint_landmarks(jnp.ones((J + 1, 3))), BODY, POSE)
    with pytest.raises(
        InputError, match=f"Marked: `vertices` has {V}, and the body has {V} vertices; expected 0 to"
    ):
        function(right + Marked(jnp.array([0, V])), BODY, POSE)


def test_keys_of_both_kinds_are_accepted():
    @checked
    def draw(key: PRNGKeyArray):
        return jax.random.normal(key)

    assert float(draw(jax.random.key(1))) == float(draw(jax.random.PRNGKey(1)))
    with pytest.raises(InputError, match="`key` is a floating-point array of shape"):
        draw(jnp.zeros(3))  # pyright: ignore[reportArgumentType]


def test_units():
    points = np.random.default_rng(0).random((100, 3))
    with pytest.raises(
        InputError, match="`points` is .* wide; expected metres, .* it looks like millimetres"
    ):
        jc.make_cloud(1700 * points)
    with pytest.raises(InputError, match="it looks like centimetres: multiply by 0.01"):
        jc.make_cloud(170 * points)
    assert float(jc.make_cloud(1.7 * points).points.max()) < 1.7
    walk = 0.5 * np.cumsum(np.ones((400, 3)), 0)
    with pytest.raises(InputError, match="make_markers: `positions` is .* wide; .*looks like millimetres"):
        jc.make_markers(1700 * points[None, :40] + walk[:, None], map(str, range(40)), 100.0)
    assert jc.make_markers(1.7 * points[None, :40] + walk[:, None], map(str, range(40)), 100.0)


# too few points to judge by
@pytest.mark.filterwarnings("ignore:. of 2 frames")
@pytest.mark.filterwarnings("ignore:the first frame is doubtful")
def test_scans_of_files_are_clouds(monkeypatch):
    """What `read_clouds` gives goes wherever clouds do, and comes to the same."""
    # searches are slow, and are not what this is about
    monkeypatch.setattr(advance, "needs_search", lambda frame: False)
    points = np.asarray(BODY.vertices, float)
    scans = Scans(["a", "b"], lambda frame: (points, points - points.mean(0), np.zeros((0, 3), int)))
    clouds = [jc.make_cloud(scan.points, scan.normals) for scan in scans]
    stacked = jc.observe.stack_clouds(clouds)
    tracker = jc.make_tracker(BODY)
    motions = [
        jc.track(BODY, source, tracker=tracker, search=False).poses
        for source in (scans, list(scans), clouds, stacked)
    ]
    for poses in motions[1:]:
        jax.tree.map(np.testing.assert_array_equal, poses, motions[0])
    streamed = [frame.pose for frame in jc.fit.track_frames(tracker, scans, search=False)]
    jax.tree.map(np.testing.assert_array_equal, jc.stack_poses(streamed).poses, motions[0])
    starts = jc.stack_poses([POSE, POSE])
    batches = [
        jc.fit.fit_batch(tracker, start, source)[0]
        for start in (starts, starts.poses)
        for source in (scans, stacked)
    ]
    for poses in batches[1:]:
        jax.tree.map(np.testing.assert_array_equal, poses, batches[0])
    for source in (scans, clouds, stacked):
        task = jc.make_adapt_task(BODY, source)
        assert task.num_frames == 2
        np.testing.assert_array_equal(task.cloud(1).points, clouds[1].points)
    for one in (clouds[0], scans[0]):
        with pytest.raises(InputError):
            jc.track(BODY, one)
    with pytest.raises(InputError, match="Cloud 0 is a floating-point array of shape .*; expected a Cloud"):
        jc.track(BODY, points[None])
