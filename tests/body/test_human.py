"""The embedded human against the file it was checked with, trimesh, and what bodies are like."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxcap import assets
from jaxcap.assets import asset_path
from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.geometry import rotation

PEOPLE = {
    "man": {},
    "thin woman": {"sex": "female", "weight": 0.0, "height": 1.55},
    "heavy man": {"weight": 1.0, "height": 1.90},
    "old heavy woman": {"sex": "female", "age": 80.0, "weight": 0.9, "muscle": 0.2, "height": 1.62},
    "strong": {"sex": 0.5, "age": 40.0, "muscle": 1.0},
    "child": {"sex": 0.3, "age": 10.0},
}
#: joints that lie deep in the flesh (the head's lies behind the mouth, which is hollow)
INNER = [
    "Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LowerBack", "Spine", "Spine1", "Neck", "LeftArm",
    "LeftForeArm", "LeftHand", "RightUpLeg", "RightLeg", "RightFoot", "RightArm", "RightForeArm", "RightHand",
]  # fmt: skip

posed = jax.jit(pose_body)


def surface(body) -> trimesh.Trimesh:
    return trimesh.Trimesh(np.asarray(body.vertices), np.asarray(body.faces), process=False)


def height(body) -> float:
    return float(np.ptp(np.asarray(body.vertices)[:, 1]))


def turned(body, turns) -> Pose:
    """The rest pose with joints, by name, turned by rotation vectors in the frame of the world."""
    pose = rest_pose(body.skeleton)
    rotations = pose.rotations
    for name, turn in turns.items():
        joint = body.skeleton.names.index(name)
        rotations = rotations.at[joint].set(rotation.exp(jnp.asarray(turn, rotations.dtype)))
    return Pose(pose.translations, rotations, pose.scale)


@pytest.mark.shared
def test_the_default_is_the_reference_body(shared):
    truth = np.load(shared / "data/body/makehuman_cmu31.npz")
    body = human()
    assert body.skeleton.names == tuple(truth["names"])
    assert body.skeleton.parents == tuple(truth["parents"])
    np.testing.assert_array_equal(body.faces, truth["faces"])
    np.testing.assert_allclose(body.vertices, truth["vertices"], atol=1e-6)
    np.testing.assert_allclose(body.skeleton.centres, truth["joint_head"], atol=1e-6)
    np.testing.assert_allclose(body.skin.bone_weights(31), truth["weights"], atol=1e-6)
    bones = truth["joint_tail"] - truth["joint_head"]
    along = rotation.to_matrix(body.skeleton.orientations)[:, :, 0]
    np.testing.assert_allclose(along, bones / np.linalg.norm(bones, axis=1, keepdims=True), atol=1e-5)


@pytest.mark.parametrize("options", PEOPLE.values(), ids=PEOPLE)
def test_people_are_sound_bodies(options):
    body = human(**options)
    mesh = surface(body)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.02
    if "height" in options:
        assert abs(height(body) - options["height"]) < 1e-5
    np.testing.assert_allclose(body.skin.bone_weights(31).sum(1), 1.0, atol=1e-12)
    assert (np.asarray(body.skin.bone_weights(31)) >= 0).all()
    inner = np.array([body.skeleton.names.index(name) for name in INNER])
    assert mesh.contains(np.asarray(body.skeleton.centres)[inner]).all()
    # a person has two alike sides
    centres = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres), strict=True))
    for name in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"):
        np.testing.assert_allclose(centres[f"Left{name}"], centres[f"Right{name}"] * [-1, 1, 1], atol=2e-3)
        assert centres[f"Left{name}"][0] > 0


@pytest.mark.parametrize("sex", ["female", "male"])
def test_options_do_what_they_say(sex):
    def volume(**options):
        return surface(human(sex=sex, height=1.70, **options)).volume

    assert volume(weight=0.0) < 0.95 * volume(weight=0.5) < 0.95 * volume(weight=1.0)
    skeletons = [human(sex=sex, height=tall).skeleton for tall in (1.5, 1.7, 1.9)]
    hip, ankle = (skeletons[0].names.index(name) for name in ("LeftUpLeg", "LeftFoot"))
    legs = [float(jnp.linalg.norm(one.centres[hip] - one.centres[ankle])) for one in skeletons]
    assert legs[0] + 0.1 < legs[1] < legs[2] - 0.1
    assert height(human(sex=sex, age=10)) < height(human(sex=sex, age=17)) < height(human(sex=sex))


@pytest.mark.parametrize(
    ("low", "high", "option", "middle"),
    [
        (0.0, 1.0, "sex", 0.5),
        (10.0, 25.0, "age", 17.5),
        (25.0, 90.0, "age", 57.5),
        (0.5, 1.0, "weight", 0.75),
    ],
)
def test_halfway_between_two_people_is_their_mean(low, high, option, middle):
    a, b, c = (human(**{option: value}) for value in (low, middle, high))
    np.testing.assert_allclose(b.vertices, 0.5 * (a.vertices + c.vertices), atol=1e-12)
    np.testing.assert_allclose(b.skeleton.centres, 0.5 * (a.skeleton.centres + c.skeleton.centres), atol=1e-7)


def test_joint_kinds():
    full, tracking = human().skeleton, human(joints="tracking").skeleton
    assert full.kinds[0] == "free"
    assert [n for n, k in zip(full.names, full.kinds, strict=True) if k == "fixed"] == [
        "LHipJoint",
        "RHipJoint",
    ]
    assert full.num_dofs == 6 + 28 * 3
    assert tracking.num_dofs == full.num_dofs - 6 * 3
    assert tracking.names == full.names


def test_positive_turns_about_the_first_axis_flex_knees_and_elbows():
    body = human(resolution="low")
    skeleton = body.skeleton
    place = {name: joint for joint, name in enumerate(skeleton.names)}
    bends = {f"{side}{part}": 1.0 for side in ("Left", "Right") for part in ("Leg", "ForeArm")}
    turns = {name: angle * np.asarray(skeleton.axes[place[name], 0]) for name, angle in bends.items()}
    rest, bent = skeleton.centres, posed(body, turned(body, turns)).joints
    for side in ("Left", "Right"):
        heel, hand, shoulder = place[f"{side}Foot"], place[f"{side}Hand"], place[f"{side}Arm"]
        assert bent[heel, 2] < rest[heel, 2] - 0.3
        reach = [jnp.linalg.norm(joints[hand] - joints[shoulder]) for joints in (rest, bent)]
        assert reach[1] < reach[0] - 0.1
    np.testing.assert_allclose(
        jnp.einsum("jka,jla->jkl", skeleton.axes, skeleton.axes), [np.eye(2)] * 31, atol=1e-6
    )


@pytest.mark.parametrize(
    ("resolution", "count", "mean", "furthest"),
    [("medium", 5000, 0.5e-3, 7e-3), ("low", 1500, 1.5e-3, 14e-3)],
)
def test_reduced_people_keep_their_shape(resolution, count, mean, furthest):
    triangles = []
    for options in PEOPLE.values():
        full, reduced = human(**options), human(**options, resolution=resolution)
        small = surface(reduced)
        assert len(small.vertices) == count
        assert small.is_watertight
        assert abs(small.volume / surface(full).volume - 1) < 0.01
        samples = np.asarray(full.vertices)[::10]
        distances = trimesh.proximity.closest_point(small, samples)[1]
        assert distances.mean() < mean
        assert distances.max() < furthest
        np.testing.assert_allclose(reduced.skin.bone_weights(31).sum(1), 1.0, atol=1e-12)
        np.testing.assert_array_equal(reduced.skeleton.centres, full.skeleton.centres)
        triangles.append(np.asarray(reduced.faces))
    assert all(np.array_equal(triangles[0], other) for other in triangles)


@pytest.mark.parametrize("resolution", ["medium", "low", 2500])
def test_reduced_people_bend_as_the_full_one_does(resolution):
    full, reduced = human(), human(resolution=resolution)
    turns = {"LeftLeg": [1.4, 0.0, 0.0], "RightUpLeg": [-1.0, 0.0, 0.2], "LeftArm": [0.0, 0.4, 0.8]}
    turns |= {"RightForeArm": [-1.0, 0.5, 0.0], "Spine": [0.3, 0.4, 0.0], "Neck": [0.2, -0.5, 0.1]}
    big, small = (posed(body, turned(body, turns)).vertices for body in (full, reduced))
    mesh = trimesh.Trimesh(np.asarray(big), np.asarray(full.faces), process=False)
    distances = trimesh.proximity.closest_point(mesh, np.asarray(small))[1]
    assert distances.mean() < 1e-3
    assert distances.max() < 6e-3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"sex": "other"}, "The sex 'other' is unknown"),
        ({"sex": 1.2}, "The sex of a human is 1.2; give a number from 0 to 1"),
        ({"age": 5.0}, "The age of a human is 5.0; give a number from 10 to 90"),
        ({"weight": -0.1}, "The weight of a human is -0.1"),
        ({"muscle": float("nan")}, "The muscle of a human is nan"),
        ({"height": 175.0}, "The height of a human is 175.0 m; .* give a number from 1.3"),
        ({"resolution": "tiny"}, "The resolution 'tiny' is unknown"),
        ({"resolution": 2}, "cannot be reduced to 2 vertices"),
        ({"joints": "some"}, "The set of joints 'some' is unknown"),
    ],
)
def test_options_out_of_range_end_in_a_sentence(options, sentence):
    # without the run-time checks of the test suite, which refuse a word outside a Literal first
    with pytest.raises(ValueError, match=sentence):
        inspect.unwrap(human)(**options)


def test_the_asset_is_found_in_a_wheel_and_in_a_checkout(tmp_path, monkeypatch, checkout):
    assert asset_path("human.npz") in (checkout / "assets/human.npz", checkout / "jaxcap/_assets/human.npz")
    package = tmp_path / "site-packages" / "jaxcap"
    (package / "_assets").mkdir(parents=True)
    (package / "_assets" / "human.npz").touch()
    monkeypatch.setattr(assets, "PACKAGE", package)
    assert asset_path("human.npz") == package / "_assets" / "human.npz"
    with pytest.raises(FileNotFoundError, match=r"The data file 'horse.npz' of jaxcap is neither at"):
        asset_path("horse.npz")


@pytest.mark.float32
def test_precision_follows_jax():
    body = human(resolution="low")
    default = jnp.zeros(()).dtype
    leaves = (body.vertices, body.skin.bone_weights(31), body.skeleton.centres, body.skeleton.orientations)
    assert {leaf.dtype for leaf in leaves} == {default}
