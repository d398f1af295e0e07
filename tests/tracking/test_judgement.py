"""Verdicts on poses in clouds: what is counted, by which part, and against what baseline."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.geometry.camera import look_at
from jaxcap.geometry.mesh import sample_surface
from jaxcap.observe.clouds import Cloud, make_cloud
from jaxcap.observe.visibility import visible_vertices
from jaxcap.tracking.judgement.baseline import (
    initial_baseline,
    mark_flagged,
    median_baseline,
    sensor_directions,
    update_baseline,
)
from jaxcap.tracking.judgement.evidence import _visible_in_camera, gather_evidence
from jaxcap.tracking.judgement.region_samples import _even_samples, region_name, sample_regions
from jaxcap.tracking.judgement.self_penetration import inside_degrees
from jaxcap.tracking.judgement.verdict import judge_evidence
from jaxcap.tracking.track_frame import make_tracker

BODY = human(resolution="low", joints="tracking")
SKELETON = BODY.skeleton
SURFACE = sample_regions(BODY)
REST = rest_pose(SKELETON)
NOTHING = initial_baseline(SURFACE)
NOBODY = sensor_directions(NOTHING)
POINTS = 3000
_pose_body = eqx.filter_jit(pose_body)


def turned(pose: Pose, **angles: float) -> Pose:
    """A pose with joints turned about their axes of flexion, radians."""
    layout, change = dof_layout(SKELETON), np.zeros(SKELETON.num_dofs)
    for name, angle in angles.items():
        change[layout.rotations[SKELETON.index(name)][1]] = angle
    return retract(SKELETON, pose, jnp.asarray(change))


def scan(pose: Pose, rng, kept=lambda points, normals: np.ones(len(points), bool), extra=()) -> Cloud:
    """POINTS of the surface; those that are not kept are replaced by others, and `extra` replace some."""
    vertices = np.asarray(_pose_body(BODY, pose).vertices)
    points, normals = sample_surface(vertices, np.asarray(BODY.faces), 4 * POINTS, rng)
    there = np.flatnonzero(kept(points, normals))[:POINTS]
    points, normals = points[there], normals[there]
    if len(extra):
        points[: len(extra)], normals[: len(extra)] = extra, rng.normal(size=np.shape(extra))
    return make_cloud(points + 0.003 * rng.normal(size=points.shape), normals)


def learned(frames: int, rng):
    """The baseline after some right frames."""
    baseline = NOTHING
    for _ in range(frames):
        baseline = update_baseline(
            baseline, gather_evidence(SURFACE, REST, scan(REST, rng), sensor_directions(baseline))
        )
    return baseline


def in_front(points, normals):
    return normals[:, 2] > 0


def judged(baseline, pose: Pose, cloud: Cloud):
    return judge_evidence(
        SURFACE, baseline, gather_evidence(SURFACE, pose, cloud, sensor_directions(baseline))
    )


def test_regions_are_limbs():
    assert {region_name(name) for name in SKELETON.names} == {
        "trunk", "head", "left arm", "right arm", "left leg", "right leg",
    }  # fmt: skip
    assert region_name("wing_03") == "wing_03"
    areas = np.bincount(SURFACE.regions, SURFACE.areas)
    assert areas.sum() == pytest.approx(1.0)
    assert areas.min() > 0.01


def test_a_right_pose_leaves_nothing_unexplained_and_nothing_empty(rng):
    evidence = gather_evidence(SURFACE, REST, scan(REST, rng), NOBODY)
    assert float(evidence.unexplained.sum()) < 0.003
    assert float(evidence.empty.sum()) < 0.003
    assert float(evidence.coverage.min()) > 0.98
    # points all over the box around the body, a fifth of all, are no surface
    lone = rng.uniform([-0.8, -0.8, -0.4], [0.8, 0.9, 0.4], (POINTS // 5, 3))
    evidence = gather_evidence(SURFACE, REST, scan(REST, rng, extra=lone), NOBODY)
    assert float(evidence.unexplained.sum()) < 0.015


def test_a_clump_of_points_is_counted_where_it_is(rng):
    """A ball a hand's breadth before the left shin, of one point in thirty."""
    shin = np.asarray(_pose_body(BODY, REST).vertices)[
        np.asarray(BODY.skin.dominant_bones()) == SKELETON.index("LeftLeg")
    ]
    ball = shin.mean(0) + [0.0, 0.0, 0.25] + 0.03 * rng.normal(size=(POINTS // 30, 3))
    evidence = gather_evidence(SURFACE, REST, scan(REST, rng, extra=ball), NOBODY)
    by_name = dict.fromkeys(SURFACE.names, 0.0)
    for name, share in zip(SURFACE.names, np.asarray(evidence.unexplained), strict=True):
        by_name[name] += share
    assert by_name["left leg"] == pytest.approx(1 / 30, rel=0.2)
    assert sum(by_name.values()) - by_name["left leg"] < 0.003


def test_a_limb_without_points_is_empty_by_its_area(rng):
    arm = np.asarray([name == "left arm" for name in SURFACE.names])
    away, cloud = turned(REST, LeftArm=0.9), scan(REST, rng)
    baseline = update_baseline(NOTHING, gather_evidence(SURFACE, REST, scan(REST, rng), NOBODY))
    evidence = gather_evidence(SURFACE, away, cloud, sensor_directions(baseline))
    area = float(SURFACE.areas @ arm[SURFACE.regions])
    assert 0.3 * area < float(jnp.sum(evidence.empty[arm])) < area
    assert float(jnp.sum(evidence.empty[~arm])) < 0.005
    for known, verdict in ((baseline, "lost"), (NOTHING, "doubtful")):
        judgement = judge_evidence(SURFACE, known, evidence)
        assert judgement.verdict == verdict
        assert any("left arm" in reason for reason in judgement.reasons)
        assert not any("leg" in reason or "head" in reason for reason in judgement.reasons)


@pytest.mark.parametrize("kept", [lambda points, normals: np.ones(len(points), bool), in_front])
def test_right_frames_are_good_and_wrong_ones_are_not(rng, kept):
    """Whole, and by a sensor that nobody has spoken of: what it cannot see is no fault."""
    baseline = NOTHING
    for frame in range(6):
        pose = turned(REST, LeftArm=0.1 * frame, RightLeg=-0.1 * frame, RightUpLeg=0.1 * frame)
        evidence = gather_evidence(SURFACE, pose, scan(pose, rng, kept), sensor_directions(baseline))
        judgement = judge_evidence(SURFACE, baseline, evidence)
        assert judgement.verdict == "good", judgement.reasons
        assert judgement.reasons == ()
        baseline = update_baseline(baseline, evidence)
    cloud = scan(pose, rng, kept)
    for wrong in (turned(pose, RightLeg=1.5), turned(pose, LeftArm=1.0), turned(pose, LeftForeArm=2.0)):
        judgement = judged(baseline, wrong, cloud)
        assert judgement.verdict == "lost"
        assert judgement.reasons
    nothing = dataclasses.replace(cloud, weights=jnp.zeros_like(cloud.weights))
    assert judged(baseline, pose, nothing).verdict == "lost"


def test_clothes_are_usual_once_they_were_seen(rng):
    """A jacket of 60 mm about the trunk: doubtful at first, and good afterwards; a lost arm is still seen."""
    trunk = [SKELETON.index(name) for name in ("LowerBack", "Spine", "Spine1")]
    offset = 0.06 * np.isin(np.asarray(BODY.skin.dominant_bones()), trunk)

    def clothed(pose):
        posed = _pose_body(BODY, pose)
        vertices = np.asarray(posed.vertices) + offset[:, None] * np.asarray(posed.normals)
        points, normals = sample_surface(vertices, np.asarray(BODY.faces), POINTS, rng)
        return make_cloud(points, normals)

    poses = [turned(REST, LeftUpLeg=0.05 * frame) for frame in range(5)]
    evidence = [gather_evidence(SURFACE, pose, clothed(pose), NOBODY) for pose in poses]
    first = judge_evidence(SURFACE, NOTHING, evidence[0])
    assert first.verdict == "doubtful"
    assert first.reasons[0] == "unexplained points near the trunk"
    one_by_one = NOTHING
    for frame in evidence:
        one_by_one = update_baseline(one_by_one, frame)
    at_once = median_baseline(jax.tree.map(lambda *leaves: jnp.stack(leaves), *evidence))
    for baseline in (one_by_one, at_once):
        again = judged(baseline, poses[2], clothed(poses[2]))
        assert again.verdict == "good", (again.shares, again.reasons)
        assert judged(baseline, turned(poses[2], RightArm=1.0), clothed(poses[2])).verdict == "lost"


@pytest.mark.parametrize("distance", [0.5, 0.8, 1.1])
def test_a_ball_within_another_by_its_area(distance):
    """Of two equal balls each has a cap within the other, of the area 2 pi R h."""
    steps = np.arange(800) + 0.5
    polar, around = np.arccos(1 - 2 * steps / 800), np.pi * (1 + 5**0.5) * steps
    ball = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], 1)
    points = np.concatenate([0.5 * ball, 0.5 * ball + [distance, 0.0, 0.0]])
    regions, areas = np.repeat([0, 1], 800), np.full(1600, np.pi / 800)
    arguments = [jnp.asarray(a) for a in (points, np.tile(ball, (2, 1)), areas, regions)]
    within = np.asarray(inside_degrees(*arguments, jnp.asarray(1.0 - np.eye(2)), 0.02))
    cap = np.pi * max(0.5 - distance / 2, 0.0)
    assert areas @ within / 2 == pytest.approx(cap, rel=0.05, abs=1e-3)
    assert not within[np.linalg.norm(points - points[800:].mean(0), axis=1)[regions == 0].argmax()]
    # a region is not within itself, nor in what it hangs on
    assert not np.asarray(inside_degrees(*arguments, jnp.zeros((2, 2)), 0.02)).any()


def test_legs_through_each_other_are_told_where_every_point_is_explained(rng):
    """A cloud of the very pose, in which one leg runs through the other."""
    layout, change = dof_layout(SKELETON), np.zeros(SKELETON.num_dofs)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        # about the line of sight: to the other leg's place
        joint = SKELETON.index(f"{side}UpLeg")
        own = Rotation.from_quat(np.asarray(SKELETON.orientations)[joint], scalar_first=True)
        change[np.asarray(layout.rotations[joint])] = own.inv().apply([0.0, 0.0, -0.25 * sign])
    crossed = retract(SKELETON, REST, jnp.asarray(change))
    for pose, verdicts in ((REST, ("good",)), (crossed, ("doubtful", "lost"))):
        evidence = gather_evidence(SURFACE, pose, scan(pose, rng), NOBODY)
        judgement = judge_evidence(SURFACE, NOTHING, evidence)
        assert judgement.verdict in verdicts, judgement.shares
    assert {"left leg inside another part of the body", "right leg inside another part of the body"} == set(
        judgement.reasons
    )


def test_a_camera_sees_what_its_depth_buffer_says():
    camera = look_at([0.4, 0.6, 2.5], [0.0, 0.0, 0.0], 320, 240, 60.0)
    posed = _pose_body(SURFACE.body, REST)
    nobody = jnp.zeros((0, 4))
    ours = np.asarray(_visible_in_camera(camera, posed.vertices, SURFACE.normals, SURFACE.size, nobody))
    corners, _ = _even_samples(np.asarray(BODY.vertices), np.asarray(BODY.faces))
    seen = np.asarray(visible_vertices(camera, BODY.vertices, BODY.faces, 0.02))[corners]
    # samples are within triangles, and those of which one corner is hidden are on an edge
    assert (ours & ~seen.any(1)).sum() < 0.02 * ours.sum()
    assert (ours & seen.all(1)).sum() > 0.6 * seen.all(1).sum()


def test_a_fault_that_grows_slowly_does_not_become_usual(rng):
    """An arm leaves the points by half a degree a frame; each frame differs from the one before by less than the noise does."""
    baseline, verdicts = learned(5, rng), []
    for angle in np.radians(np.arange(0, 60, 0.5)):
        pose, cloud = turned(REST, LeftArm=float(angle)), scan(REST, rng)
        evidence = gather_evidence(SURFACE, pose, cloud, sensor_directions(baseline))
        judgement = judge_evidence(SURFACE, baseline, evidence)
        verdicts.append(judgement.verdict)
        # the worst that may happen: that all that is not lost is learned from
        baseline = baseline if judgement.verdict == "lost" else update_baseline(baseline, evidence)
    assert verdicts[0] == "good"
    assert "good" not in verdicts[-20:]


def test_a_body_that_always_ran_through_itself_is_not_usual(rng):
    """The legs are in each other from the first frame on."""
    change = np.zeros(SKELETON.num_dofs)
    layout = dof_layout(SKELETON)
    for name, sign in (("LeftUpLeg", -1.0), ("RightUpLeg", 1.0)):
        change[layout.rotations[SKELETON.index(name)][2]] = 0.35 * sign
    crossed = retract(SKELETON, REST, jnp.asarray(change))
    baseline = NOTHING
    for _ in range(4):
        evidence = gather_evidence(SURFACE, crossed, scan(crossed, rng), sensor_directions(baseline))
        judgement = judge_evidence(SURFACE, baseline, evidence)
        baseline = update_baseline(baseline, evidence)
    assert float(np.max(evidence.inside)) > 0.02
    assert judgement.verdict != "good"
    assert any("leg inside another part" in reason for reason in judgement.reasons)


def test_parts_without_points_are_told(rng):
    """A forearm that no camera sees explains nothing and is missed by nothing, and yet its pose is a guess."""
    baseline = learned(3, rng)
    joints = np.asarray(_pose_body(BODY, REST).joints)
    elbow = joints[SKELETON.index("LeftForeArm")]

    def shown(points, normals):
        return points[:, 0] * np.sign(elbow[0]) < abs(elbow[0]) - 0.04

    def unseen(kept):
        evidence = gather_evidence(SURFACE, REST, scan(REST, rng, kept), sensor_directions(baseline))
        return judge_evidence(SURFACE, baseline, evidence).unseen

    assert not unseen(lambda points, normals: np.ones(len(points), bool))
    assert not unseen(in_front)
    assert set(unseen(shown)) == {"LeftForeArm", "LeftHand"}


def test_parts_beside_one_without_points_need_more_of_them(rng):
    """A forearm that takes a few points of the trunk is as much of a guess as the upper arm that has none."""
    baseline = learned(3, rng)
    judgement = judge_evidence(
        SURFACE, baseline, gather_evidence(SURFACE, REST, scan(REST, rng), sensor_directions(baseline))
    )
    there = {"LeftArm": 0.0, "LeftForeArm": 0.4, "RightForeArm": 0.4}
    support = np.array([there.get(part, 1.0) for part in judgement.parts])
    assert set(eqx.tree_at(lambda j: j.support, judgement, support).unseen) == {"LeftArm", "LeftForeArm"}


def test_a_fault_at_the_limit_does_not_flicker(rng):
    """After a frame that was not good, one has to lie further within the limits."""
    baseline = learned(3, rng)
    cloud = scan(turned(REST, LeftArm=0.12), rng)
    after = [judged(known, REST, cloud) for known in (baseline, mark_flagged(baseline))]
    np.testing.assert_array_equal(after[0].shares, after[1].shares)
    doubt = [float(one.doubt) for one in after]
    assert doubt[1] < doubt[0]
    between = [dataclasses.replace(one, shares=np.full((3, 18), np.mean(doubt))) for one in after]
    assert [one.verdict for one in between] == ["good", "doubtful"]
    assert (
        float(update_baseline(mark_flagged(baseline), gather_evidence(SURFACE, REST, cloud, NOBODY)).flagged)
        == 0.0
    )


@pytest.mark.parametrize(
    "build",
    [
        {"sex": "female", "weight": 0.2, "height": 1.58},
        {"age": 28, "weight": 0.4, "muscle": 0.8, "height": 1.88},
    ],
)
def test_people_of_all_builds_have_the_same_regions(build):
    """Another structure would compile every function of tracking again for each person."""
    trackers = [make_tracker(human(resolution="low", joints="tracking", **traits)) for traits in ({}, build)]
    assert jax.tree.structure(trackers[0]) == jax.tree.structure(trackers[1])
