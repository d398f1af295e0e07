"""Markers on bodies: places that are kept, derivatives, poses and people that are found again."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from helpers import chain_body, check_energy, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human_from_traits
from jaxcap.body.people.morph_targets import Traits
from jaxcap.body.pose import rest_pose
from jaxcap.fit.solve import solve
from jaxcap.io.registry import read_markers
from jaxcap.markers.body_shape.anatomical import anatomical_markers
from jaxcap.markers.body_shape.shape import bone_lengths, fit_shape
from jaxcap.markers.body_shape.surface_markers import attach_markers, surface_landmarks, vertex_markers
from jaxcap.observe.markers import make_markers

BODY = chain_body()
PERSON = Traits(sex=0.8, age=45.0, weight=0.7, muscle=0.4, stature=0.3)
LABELS = [
    "C7", "T10", "STRN", "CLAV", "SEL", "OCC", "LASI", "RASI", "LPSI", "RPSI", "LSHO", "RSHO", "LLHE", "RLHE", "LMHE",
    "RMHE", "LRS", "RRS", "LUS", "RUS", "LGT", "RGT", "LKNE", "RKNE", "LMFE", "RMFE", "LANK", "RANK", "LSPH", "RSPH",
    "LHEE", "RHEE", "LMT5", "RMT5", "LMT1", "RMT1",
]  # fmt: skip

posed = eqx.filter_jit(pose_body)
places_of = eqx.filter_jit(lambda markers, body, pose: markers.positions(pose_body(body, pose)))


def around(rng, pose, count=12):
    """Places a centimetre or so off the posed surface."""
    vertices = np.asarray(posed(BODY, pose).vertices)
    return vertices[rng.integers(0, len(vertices), count)] + 0.015 * rng.normal(size=(count, 3))


def test_markers_stay_where_they_were_seen_and_as_far_from_the_surface_as_trimesh_says(rng):
    pose = random_pose(BODY.skeleton, rng, 0.4)
    seen = around(rng, pose)
    markers = attach_markers(BODY, seen, pose)
    np.testing.assert_allclose(places_of(markers, BODY, pose), seen, atol=1e-12)
    surface = trimesh.Trimesh(np.asarray(posed(BODY, pose).vertices), np.asarray(BODY.faces), process=False)
    corners = np.sort(np.asarray(markers.attachment.corners), axis=1)
    nearest = trimesh.proximity.closest_point(surface, seen)[2]
    np.testing.assert_array_equal(corners, np.sort(np.asarray(BODY.faces)[nearest], axis=1))
    inside = (np.asarray(markers.attachment.barycentric) >= 0).all(1)
    assert inside.any()
    distances = trimesh.proximity.closest_point(surface, seen)[1]
    np.testing.assert_allclose(np.abs(markers.attachment.heights)[inside], distances[inside], atol=1e-12)


def test_a_rigid_motion_of_the_body_carries_its_markers(rng):
    rest = rest_pose(BODY.skeleton)
    markers = attach_markers(BODY, around(rng, rest))
    moved = eqx.tree_at(
        lambda p: (p.translations, p.rotations),
        rest,
        (
            rest.translations.at[0].set(jnp.array([0.3, -0.2, 0.5])),
            rest.rotations.at[0].set(jnp.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])),
        ),
    )
    before, after = (np.asarray(places_of(markers, BODY, pose)) for pose in (rest, moved))
    turn = np.array([[np.cos(0.8), 0, np.sin(0.8)], [0, 1, 0], [-np.sin(0.8), 0, np.cos(0.8)]])
    root = np.asarray(BODY.skeleton.centres[0])
    np.testing.assert_allclose(after, (before - root) @ turn.T + root + [0.3, -0.2, 0.5], atol=1e-12)


def test_the_energy_against_central_differences(rng):
    markers = attach_markers(BODY, around(rng, rest_pose(BODY.skeleton)))
    targets = rng.normal(size=(12, 3))
    seen = rng.uniform(size=12) < 0.7
    targets[~seen] = np.nan
    energy = surface_landmarks(markers, targets, seen, deviation=0.5)
    check_energy(3.0 * energy, BODY, [random_pose(BODY.skeleton, rng, 0.8)])


def test_solve_finds_the_pose_through_markers_that_were_seen(rng):
    truth, away = random_pose(BODY.skeleton, rng, 0.3), random_pose(BODY.skeleton, rng, 1e-9)
    markers = attach_markers(BODY, around(rng, truth, 60), truth)
    seen = np.arange(60) % 5 > 0
    places = np.where(seen[:, None], places_of(markers, BODY, truth), 1e3)
    solution = solve(surface_landmarks(markers, places, seen), BODY, away)
    np.testing.assert_allclose(solution.pose.rotations[:3], truth.rotations[:3], atol=1e-4)
    found = np.asarray(places_of(markers, BODY, solution.pose))
    np.testing.assert_allclose(found[seen], places[seen], atol=1e-5)


def test_markers_on_chosen_vertices_stand_over_them():
    markers = vertex_markers(BODY, {"a": 3, "b": 20}, height=0.01)
    rest = posed(BODY, rest_pose(BODY.skeleton))
    apart = np.asarray(places_of(markers, BODY, rest_pose(BODY.skeleton)) - rest.vertices[jnp.array([3, 20])])
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), 0.01, atol=1e-12)
    # outwards
    assert (np.sum(apart * np.asarray(rest.normals[jnp.array([3, 20])]), 1) > 0.001).all()


@pytest.mark.parametrize("resolution", ["low", "full"])
def test_landmarks_lie_where_the_anatomy_has_them(resolution):
    body = human_from_traits(Traits(1.0, 25.0, 0.5, 0.5), resolution)
    markers = anatomical_markers([*LABELS, "no landmark"], resolution)
    assert markers.labels == tuple(LABELS)
    at = dict(zip(LABELS, np.asarray(places_of(markers, body, rest_pose(body.skeleton))), strict=True))
    joints = dict(zip(body.skeleton.names, np.asarray(body.skeleton.centres), strict=True))
    for side, sign, name in (("L", 1, "Left"), ("R", -1, "Right")):
        # the middle of the epicondyles and of the malleoli is the joint between them (Wu et al. 2002)
        for pair, joint, reach in (
            (("KNE", "MFE"), "Leg", 0.03),
            (("ANK", "SPH"), "Foot", 0.03),
            (("LHE", "MHE"), "ForeArm", 0.03),
            (("RS", "US"), "Hand", 0.03),
        ):
            middle = (at[side + pair[0]] + at[side + pair[1]]) / 2
            assert np.linalg.norm(middle - joints[name + joint]) < reach, pair
        assert sign * (at[f"{side}KNE"] - at[f"{side}MFE"])[0] > 0.06
        assert at[f"{side}ASI"][2] > at[f"{side}PSI"][2] + 0.1
        assert at[f"{side}HEE"][2] < joints[f"{name}Foot"][2] - 0.03
    assert at["C7"][2] < joints["Neck"][2] - 0.03
    assert at["STRN"][2] > joints["Spine1"][2] + 0.05


@pytest.fixture(scope="module")
def stood():
    """A person that stands with bent limbs, turned and moved, seen with 2 mm of noise and with gaps."""
    rng = np.random.default_rng(4)
    body = human_from_traits(PERSON, "low", "tracking")
    markers = anatomical_markers(LABELS, "low")
    still = random_pose(body.skeleton, rng, 0.12)
    pose = eqx.tree_at(
        lambda p: (p.translations, p.rotations),
        still,
        (
            still.translations.at[0].set(jnp.array([0.5, 0.1, -1.0])),
            still.rotations.at[0].set(jnp.array([np.cos(1.1), 0.0, 0.0, np.sin(1.1)])),
        ),
    )
    places = np.asarray(places_of(markers, body, pose)) + 0.002 * rng.normal(size=(20, len(LABELS), 3))
    places[rng.uniform(size=places.shape[:2]) < 0.2] = np.nan
    places[:3, 4] += 1.0
    return body, pose, make_markers(places, tuple(LABELS), 100.0)


def test_the_person_of_a_static_trial_is_found(stood):
    body, pose, frames = stood
    fit = fit_shape(frames, known_traits={"age": 45.0}, deviation=0.001)
    assert np.nanmax(fit.residuals) < 0.01
    tall = [float(np.ptp(np.asarray(b.vertices)[:, 1])) for b in (fit.body, body)]
    assert abs(tall[0] - tall[1]) < 0.015
    for found, true, deviation, name in zip(fit.traits, PERSON, fit.deviations, Traits._fields, strict=True):
        assert abs(found - true) < 0.15 if name != "age" else found == 45.0 and deviation == 0.0
    joints = [np.asarray(posed(*both).joints) for both in ((fit.body, fit.pose), (body, pose))]
    turning = [body.skeleton.index(name) for name in ("LeftLeg", "RightFoot", "LeftForeArm", "RightUpLeg")]
    assert np.linalg.norm(joints[0] - joints[1], axis=1)[turning].max() < 0.015


def test_the_person_with_given_bones_is_found_and_what_bones_do_not_tell_is_told():
    body = human_from_traits(PERSON, "low")
    fit = fit_shape(lengths=bone_lengths(body.skeleton))
    lengths, true = (np.array(list(bone_lengths(b.skeleton).values())) for b in (fit.body, body))
    assert np.abs(lengths - true).max() < 0.003
    assert fit.deviations.stature < 0.05
    tall = fit_shape(lengths={("LeftUpLeg", "LeftLeg"): 0.45}, height=1.82)
    assert abs(float(np.ptp(np.asarray(tall.body.vertices)[:, 1])) - 1.82) < 0.005
    assert any("weight is poorly determined" in sentence for sentence in tall.messages)
    assert tall.deviations.weight > fit.deviations.weight


@pytest.mark.shared
def test_a_real_static_trial(shared):
    """73 markers by their anatomical names; the marker on the head's top is 1.68 m over the ground."""
    frames = read_markers(shared / "data/markers/biobuddy_static.c3d")
    fit = fit_shape(frames)
    assert np.nanmean(fit.residuals) < 0.025
    assert 1.63 < float(np.ptp(np.asarray(fit.body.vertices)[:, 1])) < 1.73
    assert 0.36 < bone_lengths(fit.body.skeleton)["LeftUpLeg", "LeftLeg"] < 0.45


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: attach_markers(BODY, np.full((1, 3), 9.0), labels=["A"]), "Marker 'A' is .* check the unit"),
        (lambda: attach_markers(BODY, np.full((1, 3), np.nan)), "position of marker 'marker0' is not finite"),
        (lambda: attach_markers(BODY, np.zeros((2, 3)), labels=["A", "A"]), "'A' occurs twice"),
        (lambda: attach_markers(BODY, np.zeros((2, 2))), r"shape \(2, 2\)"),
        (lambda: vertex_markers(BODY, {"A": 4800}), "'A' is on vertex 4800, which is in no triangle"),
        (lambda: anatomical_markers(["X1", "X2"]), "None of the labels X1, X2"),
        (lambda: fit_shape(), "neither frames nor bone lengths"),
        (lambda: fit_shape(lengths={("LeftLeg", "Tail"): 0.4}), "no joint 'Tail'"),
        (lambda: fit_shape(lengths={("LeftLeg", "LeftFoot"): 400.0}), "is 400.0 m; expected metres"),
        (
            lambda: fit_shape(lengths={("LeftLeg", "LeftFoot"): 0.4}, known_traits={"hair": 1.0}),
            "no trait 'hair'",
        ),
        (
            lambda: fit_shape(lengths={("LeftLeg", "LeftFoot"): 0.4}, known_traits={"age": 3.0}),
            "age of a human is 3.0",
        ),
        (lambda: fit_shape(make_markers(np.zeros((2, 1, 3)) + 1, ("C7",), 100.0)), "Only 1 markers are both"),
    ],
)
def test_what_cannot_be_done_ends_in_a_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
