"""Floors and walls in clouds: found without a camera, removed, and never seen in people."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.cli.track.input import TrackInput, floor_below_person
from jaxcap.io.lazy_frames import LazyFrames
from jaxcap.observe.floors_and_walls import describe_room, without_room

BODY = jc.human(resolution="low", joints="tracking")
FLOOR = -0.82


def person(frame: int = 0) -> tuple[np.ndarray, np.ndarray]:
    posed = jc.pose_body(BODY, jc.rest_pose(BODY.skeleton))
    return np.asarray(posed.vertices, float) + [0.01 * frame, 0, 0], np.asarray(posed.normals, float)


def plane(axis: int, offset: float, count: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Points of a square of 3 m, with 5 mm of noise and normals tilted by 10 degrees."""
    points = rng.uniform(-1.5, 1.5, (count, 3))
    points[:, axis] = offset + 0.005 * rng.normal(size=count)
    return points, np.eye(3)[axis] + np.radians(10) / np.sqrt(2) * rng.normal(size=points.shape)


def cloud_of(*parts) -> jc.Cloud:
    return jc.make_cloud(np.concatenate([p for p, _ in parts]), np.concatenate([n for _, n in parts]))


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(2)
    return person(), plane(1, FLOOR, 900, rng), plane(2, -0.9, 900, rng)


def test_floor_and_wall_are_where_they_were_put(scene):
    planes = jc.observe.find_room(cloud_of(*scene))
    assert len(planes) == 2
    floor = jc.observe.find_floor(list(planes))
    wall = next(plane for plane in planes if plane is not floor)
    assert floor.normal[1] > 0.999 and abs(floor.offset - FLOOR) < 5e-3
    # the normal points to the person, without a camera
    assert wall.normal[2] > 0.999 and abs(wall.offset + 0.9) < 3e-3
    assert describe_room(cloud_of(*scene), planes).startswith("a floor or ceiling and a wall with 5")


def test_the_floor_of_clouds_is_the_one_below_the_person(scene, tmp_path):
    cloud = cloud_of(*scene)
    found = TrackInput(LazyFrames(["cloud"], lambda _: cloud), None, [], [])
    floor = floor_below_person(found, jc.observe.find_room(cloud), tmp_path / "journal", False)
    assert floor is not None and floor.normal[1] > 0.999 and abs(floor.offset - FLOOR) < 5e-3
    # planes that are kept are none
    assert floor_below_person(found, (), tmp_path / "journal", False) is None


def test_the_person_stays_and_the_room_goes(scene):
    body, floor, wall = scene
    cloud = cloud_of(*scene)
    left = jc.observe.remove_planes(cloud, jc.observe.find_room(cloud))
    points = np.asarray(left.points)[np.asarray(left.weights) > 0]
    away = np.array([np.abs(points - row).max(1).min() for row in body[0]])
    # all of the person but the soles, and next to nothing of the room
    assert (away[body[0][:, 1] > FLOOR + 0.04] < 1e-6).all()
    kept = int((away < 1e-6).sum())
    assert kept > 0.85 * len(body[0])
    assert len(points) - kept < 0.01 * (len(floor[0]) + len(wall[0]))


def test_points_of_a_foot_above_the_noise_stay(scene):
    floor = cloud_of(scene[1])
    foot = np.array([[0.0, FLOOR + 0.02, 0.0], [0.0, FLOOR + 0.02, 0.1], [0.0, FLOOR + 0.001, 0.0]])
    sideways = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]])
    cloud = cloud_of(scene[0], scene[1], (foot, sideways))
    left = np.asarray(jc.observe.remove_planes(cloud, jc.observe.find_room(floor)).points)
    nearest = [np.abs(left - row).max(1).min() for row in foot]
    assert nearest[0] < 1e-6 and nearest[1] > 1e-6 and nearest[2] > 1e-6


@pytest.mark.parametrize("angles", [(0, 0, 0), (90, 0, 0), (0, 45, 90)])
def test_people_are_no_room(angles):
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    for pose in range(6):
        poses = jc.body.sample_poses(BODY.skeleton, count=6)
        posed = jc.pose_body(BODY, jc.Motion(poses, 30.0)[pose])
        points, normals = np.asarray(posed.vertices) @ turn.T, np.asarray(posed.normals) @ turn.T
        assert jc.observe.find_room(jc.make_cloud(points, normals)) == ()
        # seen from one side
        front = normals[:, 2] > 0
        assert jc.observe.find_room(jc.make_cloud(points[front], normals[front])) == ()


def test_planes_of_the_first_cloud_are_removed_from_all(scene):
    body, floor, _ = scene
    clouds = [cloud_of(body, floor), cloud_of(body), cloud_of(body, floor)]
    missing = jc.observe.missing_cloud("Nobody is here.")
    counts = [int((np.asarray(one.weights) > 0).sum()) for one in without_room([missing, *clouds], None)]
    assert counts[0] == 0 and counts[1] == counts[3] and counts[1] < len(body[0]) + 10
    kept = list(without_room(clouds, ()))
    assert kept == clouds
    planes = jc.observe.find_room(clouds[0])
    cleared = [jc.observe.remove_planes(cloud, planes) for cloud in clouds]
    assert len(cleared) == 3 and len(cleared[0].points) == len(cleared[1:][1].points)


def test_a_person_on_a_floor_is_tracked_as_without_it():
    rng = np.random.default_rng(4)
    floors = [plane(1, FLOOR, 1000, rng) for _ in range(3)]
    clean = list(jc.fit.track_frames(jc.make_tracker(BODY), [cloud_of(person(k)) for k in range(3)]))
    found = list(
        jc.fit.track_frames(jc.make_tracker(BODY), [cloud_of(person(k), floors[k]) for k in range(3)])
    )
    assert [frame.verdict for frame in found] == ["good"] * 3
    ours, theirs = (jc.pose_body(BODY, frames[-1].pose).joints for frames in (found, clean))
    assert float(jnp.linalg.norm(ours - theirs, axis=1).max()) < 5e-3


def test_estimated_normals_point_out_of_a_person_on_a_floor(scene):
    body, floor, _ = scene
    cloud = jc.make_cloud(np.concatenate([body[0], floor[0]]))
    left = jc.observe.remove_planes(cloud, jc.observe.find_room(cloud))
    points, normals = (np.asarray(x)[np.asarray(left.weights) > 0] for x in (left.points, left.normals))
    nearest = np.array([np.argmin(np.linalg.norm(body[0] - point, axis=1)) for point in points])
    agree = np.sum(normals * body[1][nearest], axis=1) > 0
    alone = jc.make_cloud(body[0])
    real = np.asarray(alone.weights) > 0
    order = np.array(
        [np.argmin(np.linalg.norm(body[0] - point, axis=1)) for point in np.asarray(alone.points)[real]]
    )
    expected = np.sum(np.asarray(alone.normals)[real] * body[1][order], axis=1) > 0
    # as often as without a floor
    assert agree.mean() > expected.mean() - 0.02
