"""Several people in the same clouds: shares of points, separate and crossing people, entry, exchanges."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface
from jaxcap.observe.clouds import Cloud, make_cloud
from jaxcap.tracking.advance import make_follower
from jaxcap.tracking.judge_frame import track_first_frame
from jaxcap.tracking.judgement.evidence import NUM_DIRECTIONS, _fibonacci_directions, gather_evidence
from jaxcap.tracking.people.exchange import end_contact, try_exchange, with_contacts
from jaxcap.tracking.people.groups import assign_to_groups, find_groups
from jaxcap.tracking.people.other_people import shows_others
from jaxcap.tracking.people.person_frame import CORRECTED, UNDECIDED, UNSURE, absent_person, enter
from jaxcap.tracking.people.point_shares import (
    ALONG_DEVIATION,
    NOBODY_DENSITY,
    OUTLIER_DEVIATION,
    STRIDE,
    person_density,
    person_weights,
    responsibilities,
)
from jaxcap.tracking.people.track_people import track_people
from jaxcap.tracking.track import others_sentences, track_frames
from jaxcap.tracking.track_frame import make_tracker

POINTS, NOISE = 600, 0.003
BODY = human(resolution="low", joints="tracking")
SKELETON = BODY.skeleton
TRACKER = make_tracker(BODY)
FOLLOWER = make_follower(TRACKER)
_pose_body = eqx.filter_jit(pose_body)


def standing(x: float, z: float = 0.0, degrees: float = 0.0, swing: float = 0.0) -> Pose:
    """A pose near rest at some position, turned about the vertical, with swinging arms and legs."""
    layout, change = dof_layout(SKELETON), np.zeros(SKELETON.num_dofs)
    for name, sign in (("LeftArm", 1), ("RightArm", -1), ("LeftUpLeg", -1), ("RightUpLeg", 1)):
        change[layout.rotations[SKELETON.index(name)][0]] = sign * swing
    pose = retract(SKELETON, rest_pose(SKELETON), jnp.asarray(change))
    turn = rotation.about_axis(jnp.array([0.0, 1.0, 0.0]), jnp.asarray(np.radians(degrees)))
    return Pose(
        pose.translations.at[0].add(jnp.array([x, 0.0, z])),
        pose.rotations.at[0].set(rotation.multiply(turn, pose.rotations[0])),
        pose.scale,
    )


def surface_points(pose: Pose, rng, body=BODY):
    points, normals = sample_surface(
        np.asarray(_pose_body(body, pose).vertices), np.asarray(body.faces), POINTS, rng
    )
    return points + NOISE * rng.normal(size=points.shape), normals


def scan(poses, rng, bodies=None) -> Cloud:
    each = [surface_points(pose, rng, body) for pose, body in zip(poses, bodies or [BODY] * 9, strict=False)]
    points, normals = (np.concatenate(parts) for parts in zip(*each, strict=True))
    # padded to one length, whoever is there
    missing = 2 * POINTS - len(points)
    weights = np.pad(np.ones(len(points)), (0, missing))
    points, normals = (np.pad(a, ((0, missing), (0, 0)), mode="edge") for a in (points, normals))
    return make_cloud(points, normals, weights)


def joint_error(a: Pose, b: Pose) -> float:
    apart = _pose_body(BODY, a).joints - _pose_body(BODY, b).joints
    return float(jnp.mean(jnp.linalg.norm(apart, axis=1)))


def largest_change(a: Pose, b: Pose) -> float:
    return float(jnp.abs(difference(SKELETON, a, b)).max())


def test_shares_are_those_of_bayes_rule(rng):
    log_densities = rng.normal(scale=8.0, size=(3, 50))
    log_densities[1, :5] = -np.inf
    shares = np.asarray(responsibilities(jnp.asarray(log_densities)))
    for point in range(50):
        densities = [float(np.exp(value)) for value in log_densities[:, point]]
        total = sum(densities) + NOBODY_DENSITY
        np.testing.assert_allclose(shares[:, point], [density / total for density in densities], atol=1e-12)
    assert shares.sum(0).max() <= 1.0 + 1e-12


def test_one_person_sees_all_weights(rng):
    shares = responsibilities(jnp.asarray(rng.normal(scale=8.0, size=(1, 50))))
    weights = jnp.asarray(rng.uniform(size=50))
    seen = person_weights(weights, shares, jnp.zeros(50), 0, jnp.inf)
    assert (np.asarray(seen) == np.asarray(weights)).all()


def test_density_of_a_person_is_that_of_a_slow_loop(rng):
    pose, sigma = standing(0.3, swing=0.2), 0.015
    cloud = scan([pose, standing(1.0)], rng)
    found = person_density(TRACKER, FOLLOWER.surface, pose, jnp.asarray(sigma), cloud)
    posed = _pose_body(BODY, pose)
    vertices, normals = np.asarray(posed.vertices), np.asarray(posed.normals)
    samples = np.asarray(_pose_body(FOLLOWER.surface.body, pose).vertices)[::STRIDE]
    num_parts = len(np.unique(np.asarray(BODY.skin.dominant_bones())))
    share, along = 0.1, (sigma / ALONG_DEVIATION) ** 2
    for row in rng.choice(2 * POINTS, 60, replace=False):
        point, normal = np.asarray(cloud.points[row]), np.asarray(cloud.normals[row])
        away = np.linalg.norm(vertices - point, axis=1)
        away[normals @ normal <= 0.5] = np.inf
        nearest = int(np.argmin(away))
        density = 0.0
        # farther away the search of vertices ends
        if 0.12 < away[nearest] < 0.25:
            continue
        if away[nearest] < 0.2:
            across = float((point - vertices[nearest]) @ normals[nearest]) ** 2
            squared = across + along * (away[nearest] ** 2 - across)
            density = np.exp(-squared / (2 * sigma**2)) / (2 * np.pi * sigma**2) ** 1.5 / num_parts
        gap = np.linalg.norm(samples - point, axis=1).min()
        own = np.exp(-(gap**2) / (2 * OUTLIER_DEVIATION**2)) / (2 * np.pi * OUTLIER_DEVIATION**2) ** 1.5
        expected = (1 - share) * density + share * own / num_parts
        assert float(found.distances[row]) == pytest.approx(gap, abs=1e-6)
        assert float(jnp.exp(found.log_density[row])) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_one_person_is_tracked_as_by_the_plain_tracker(rng):
    poses = [standing(0.01 * frame, swing=0.05 * frame) for frame in range(3)]
    clouds = [scan([pose], rng) for pose in poses]
    plain = list(track_frames(TRACKER, clouds, poses[0], search=False, sigma=0.05))
    people = list(track_people(TRACKER, clouds, 1, [poses[0]], search=False, sigma=0.05))
    for alone, (person,) in zip(plain, people, strict=True):
        assert largest_change(alone.pose, person.pose) < 1e-12
        assert alone.verdict == person.verdict
        assert float(alone.statistics.log_likelihood) == float(person.statistics.log_likelihood)


@pytest.fixture(scope="module")
def separate():
    """Two people far from each other, the second of whom comes in the third frame and leaves in the sixth."""
    rng = np.random.default_rng(3)
    truth = [[standing(0.01 * f, swing=0.04 * f), standing(1.6, 0.01 * f, 0.0, 0.03 * f)] for f in range(7)]
    clouds = [scan(poses if f in (2, 3, 4) else poses[:1], rng) for f, poses in enumerate(truth)]
    return truth, clouds, list(track_people(TRACKER, clouds, 2, search=False))


def test_separate_people_are_tracked_as_alone(separate):
    truth, _, _ = separate
    first, second = ([poses[k] for poses in truth[:3]] for k in range(2))
    clouds = [scan(poses, np.random.default_rng([5, f])) for f, poses in enumerate(truth[:3])]
    together = list(track_people(TRACKER, clouds, 2, [first[0], second[0]], search=False, sigma=0.03))
    for k, own in enumerate((first, second)):
        alone = []
        for cloud, poses in zip(clouds, truth, strict=False):
            middle = 0.5 * float(poses[0].translations[0, 0] + poses[1].translations[0, 0])
            side = (cloud.points[:, 0] > middle) == bool(k)
            alone.append(eqx.tree_at(lambda c: c.weights, cloud, jnp.where(side, cloud.weights, 0.0)))
        for single, frame in zip(
            track_frames(TRACKER, alone, own[0], search=False, sigma=0.03), together, strict=True
        ):
            assert largest_change(single.pose, frame[k].pose) < 1e-6
            assert frame[k].verdict == "good"


def test_a_person_comes_and_leaves(separate):
    truth, _, frames = separate
    assert [[person.present for person in frame] for frame in frames] == [
        [True, f in (2, 3, 4)] for f in range(7)
    ]
    assert [frame[1].seen for frame in frames] == [f >= 2 for f in range(7)]
    assert frames[0][1].reasons == ("this person has not been in the scene yet",)
    assert "not in the scene" in frames[5][1].reasons[0]
    for poses, frame in zip(truth, frames, strict=True):
        for true, person in zip(poses, frame, strict=True):
            assert joint_error(true, person.pose) < 0.01 or not person.present
            assert person.verdict == ("good" if person.present else "lost")


def test_a_run_continues_bit_by_bit(separate):
    _, clouds, frames = separate
    rest = list(track_people(TRACKER, clouds[4:], 2, frames[3], first=4, search=False))
    for again, frame in zip(rest, frames[4:], strict=True):
        leaves = zip(jax.tree.leaves(again), jax.tree.leaves(frame), strict=True)
        assert all(np.array_equal(a, b) for a, b in leaves)


def test_the_number_of_people_is_found(separate):
    _, clouds, _ = separate
    frames = list(track_people(TRACKER, clouds[1:4], search=False))
    assert [len(frame) for frame in frames] == [1, 2, 2]


def test_people_who_cross_keep_their_identity():
    """Their hands pass each other at a distance of 6 cm."""
    rng = np.random.default_rng(4)
    steps = np.linspace(-0.5, 0.5, 11)
    truth = [
        [
            standing(-0.6, step, swing=0.3 * np.sin(6 * step)),
            standing(0.6, -step, 180.0, 0.3 * np.cos(6 * step)),
        ]
        for step in steps
    ]
    clouds = [scan(poses, rng) for poses in truth]
    for poses, frame in zip(
        truth, track_people(TRACKER, clouds, 2, truth[0], search=False, sigma=0.03), strict=True
    ):
        for true, person in zip(poses, frame, strict=True):
            assert joint_error(true, person.pose) < 0.012
            assert person.verdict == "good"
            assert not person.exchange_reasons


def placed(bodies, poses, clouds):
    """Frames of people with some bodies, tracked at given poses in clouds of one person each."""
    followers, people = [], []
    for k, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        followers.append(make_follower(make_tracker(body)))
        own = followers[k]
        tracked = track_first_frame(own.tracker, own.surface, clouds[k], pose, 0.05)
        person = enter(absent_person(own.tracker, own.surface, 2), tracked, float(POINTS))
        people.append(with_contacts(person, np.where(np.arange(2) == k, 0.0, UNSURE)))
    return followers, people


def test_an_exchange_is_corrected_or_given_as_a_reason(rng):
    tall = human(resolution="low", joints="tracking", height=1.9)
    poses = [standing(0.0), standing(1.0, swing=0.1)]
    alone = [scan([pose], rng, [body]) for pose, body in zip(poses, (BODY, tall), strict=True)]
    # each body is tracked in the points of the other person
    followers, people = placed((tall, BODY), poses, alone)
    clouds = dict(enumerate(alone))
    after = end_contact(followers, people, clouds, (0, 1))
    assert [person.exchanges.tolist() for person in after] == [[0.0, CORRECTED], [CORRECTED, 0.0]]
    assert joint_error(after[1].pose, poses[0]) < 0.01
    assert all(person.contacts.tolist() == [0.0, 0.0] for person in after)
    # right ones stay
    followers, people = placed((BODY, tall), poses, alone)
    assert try_exchange(followers, people, clouds, (0, 1)).gain < 0
    assert not any(person.exchange_reasons for person in end_contact(followers, people, clouds, (0, 1)))
    # equal bodies cannot be distinguished
    followers, people = placed((BODY, BODY), poses, alone)
    after = end_contact(followers, people, clouds, (0, 1))
    assert [person.exchanges.max() for person in after] == [UNDECIDED, UNDECIDED]
    assert after[0].reasons[0] == "this person may have been exchanged with person 2"
    assert after[0].verdict == "doubtful"


def test_groups_of_points_are_people(rng):
    up = np.array([0.0, 1.0, 0.0])
    height = float(np.ptp(np.asarray(BODY.vertices), axis=0).max())
    # the second and the third touch with their hands
    truth = [surface_points(standing(x), rng)[0] for x in (-3.0, 0.0, 0.9)]
    outliers = rng.uniform([-4, -1, -1], [2, 1, 1], (180, 3))
    points = np.concatenate([*truth, outliers])
    groups = find_groups(points, height, up)
    owners = np.repeat(np.arange(4), [POINTS, POINTS, POINTS, len(outliers)])
    assert len(groups) == 3
    found = [np.bincount(owners[group], minlength=4) for group in groups]
    assert sorted(int(np.argmax(counts)) for counts in found) == [0, 1, 2]
    assert all(counts.max() > 0.9 * POINTS for counts in found)
    masks = assign_to_groups(points, groups)
    assert np.sum(masks, axis=0).max() == 1
    # one person with the arms away from the trunk is one
    assert len(find_groups(truth[0], height, up)) == 1
    assert find_groups(0.1 * truth[0], height, up) == []


def test_another_person_in_the_cloud_of_one_body_is_found(rng):
    alone, both = scan([standing(0.0)], rng), scan([standing(0.0), standing(1.3)], rng)
    assert not shows_others(FOLLOWER, standing(0.0), alone)
    assert shows_others(FOLLOWER, standing(0.0), both)
    (sentence,) = others_sentences([False, True])
    assert sentence.startswith("1 of 2 frames show something else of a person's size")
    assert ": 1, counted from 0" in sentence
    assert others_sentences([False, False]) == []


def test_surface_behind_others_may_be_empty(rng):
    """A camera in front sees a person only beside the other one."""
    points, normals = surface_points(standing(0.0), rng)
    hidden = (np.abs(points[:, 0]) < 0.2) & (points[:, 1] < 0.9)
    kept = (normals[:, 2] > 0) & ~hidden
    cloud = make_cloud(points[kept], normals[kept])
    sensors = jnp.asarray(_fibonacci_directions(NUM_DIRECTIONS)[:, 2] > 0.9, float)
    other = np.asarray(_pose_body(FOLLOWER.surface.body, standing(0.0, 1.0)).vertices)
    before = jnp.asarray(np.pad(other, ((0, 0), (0, 1)), constant_values=1.0))
    empty = [
        float(gather_evidence(FOLLOWER.surface, standing(0.0), cloud, sensors, occluders).empty.sum())
        for occluders in (None, before, before.at[:, 3].set(0.0))
    ]
    assert empty[1] < 0.2 * empty[0]
    assert empty[0] == empty[2] > 0.05


def test_wrong_numbers_are_refused():
    with pytest.raises(InputError, match="2 trackers, but `num_people` is 3"):
        track_people([TRACKER, TRACKER], [], 3)
    with pytest.raises(InputError, match="1 starts; expected 2"):
        track_people(TRACKER, [], 2, [rest_pose(SKELETON)])
