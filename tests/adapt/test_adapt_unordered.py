"""Scans without an order in time: how alike they are, whether their order says something, and their poses."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import POINTS, make_scene, task_of, write_scan
from command_line import fails
from scipy.sparse.csgraph import minimum_spanning_tree

import jaxcap as jc
from jaxcap.adapt.history import append_history
from jaxcap.adapt.poses import unordered
from jaxcap.adapt.poses.flag_frames import NO_SCAN, distance_limit, flag_frames
from jaxcap.adapt.poses.similarity import (
    DIRECTIONS,
    distance_field,
    is_unordered,
    rotated_distances,
    scan_distance,
)
from jaxcap.adapt.poses.unordered import find_poses, visiting_order, worse_than_usual
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import AdaptSettings, AdaptState, OtherPerson, plan_stages
from jaxcap.body.pose import stack_poses
from jaxcap.body.retraction import retract
from jaxcap.cli.adapt.input import format_explained, warn_of_lost, warn_of_others
from jaxcap.cli.adapt.state import make_checkpoint, restore_state
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.tracking import advance
from jaxcap.tracking.expectation_maximisation.pose_log_density import pose_log_density
from jaxcap.tracking.track import track_frames
from jaxcap.tracking.track_frame import make_tracker

_posed = eqx.filter_jit(jc.pose_body)
UNORDERED = AdaptSettings(num_frames=3, proportion_rounds=1, rounds=(1,), unordered=True)
#: of the chain body, metres
HEIGHT = 0.7


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture(scope="module")
def mixed(scene):
    """Scans of the actor of `scene` in poses that have nothing to do with each other, and the task of finding them."""
    _, actor, poses, _ = scene
    rng, skeleton = np.random.default_rng(4), actor.skeleton
    some = [
        retract(skeleton, poses[0], jnp.asarray(0.3 * rng.normal(size=skeleton.num_dofs))) for _ in range(7)
    ]
    clouds = []
    for pose in (poses[0], *some):
        vertices = np.asarray(_posed(actor, pose).vertices, float)
        clouds.append(jc.make_cloud(*sample_surface(vertices, np.asarray(actor.faces), POINTS, rng)))
    task = task_of(scene)._replace(cloud=clouds.__getitem__, num_frames=len(clouds), settings=UNORDERED)
    return task, actor, [poses[0], *some]


def turned(cloud: jc.Cloud, angle: float, shift=(0.0, 0.0, 0.0)) -> jc.Cloud:
    """A cloud turned about y, right-handed, and moved."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return jc.Cloud(cloud.points @ turn.T + jnp.asarray(shift), cloud.normals @ turn.T, cloud.weights)


def test_a_cloud_that_was_turned_and_moved_is_the_same_in_that_direction(mixed):
    cloud = mixed[0].cloud(3)
    angle = 2 * np.pi * 7 / DIRECTIONS
    apart = rotated_distances(
        distance_field(cloud, HEIGHT), distance_field(turned(cloud, angle, (1.0, 0.2, -2.0)), HEIGHT)
    )
    assert np.argmin(apart) == 7
    # the middle is a median along axes, which turn with it only about
    assert apart[7] < 0.3 * np.median(apart)
    plain = [
        np.sqrt(
            np.mean(
                (
                    np.roll(distance_field(cloud, HEIGHT).field, k, 1)
                    - distance_field(mixed[0].cloud(1), HEIGHT).field
                )
                ** 2
            )
        )
        for k in range(DIRECTIONS)
    ]
    found = rotated_distances(distance_field(cloud, HEIGHT), distance_field(mixed[0].cloud(1), HEIGHT))
    np.testing.assert_allclose(found, plain, atol=1e-7)


def test_an_order_in_time_shows(rng):
    """A body that wanders is in order until it is shuffled; one that stands still, and few scans, are in any."""
    points = rng.normal(size=(300, 3)) * [0.2, 0.5, 0.1]
    bend = np.linspace(-1.0, 1.0, 24)[:, None, None] * points[None, :, 1:2] ** 2 * [1.0, 0.0, 0.5]
    clouds = [jc.make_cloud(points + shift, points) for shift in bend]
    assert not is_unordered(clouds.__getitem__, range(24), 1.5)
    assert not is_unordered(clouds.__getitem__, range(0, 24, 3), 1.5)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(24)
        assert is_unordered([clouds[n] for n in order].__getitem__, range(24), 1.5)
    still = [jc.make_cloud(points + 0.003 * rng.normal(size=points.shape), points) for _ in range(24)]
    assert not is_unordered(still.__getitem__, range(24), 1.5)
    order = np.random.default_rng(0).permutation(5)
    assert not is_unordered([clouds[4 * n] for n in order].__getitem__, range(5), 1.5)
    assert scan_distance(*(distance_field(clouds[0], 1.5),) * 2) == 0.0


def test_frames_are_visited_along_the_shortest_tree(mixed):
    task = mixed[0]
    shapes = {n: distance_field(task.cloud(n), HEIGHT) for n in task.scanned}
    order = visiting_order(shapes)
    assert order[0] == 0
    assert sorted(order) == task.scanned
    apart = np.array([[rotated_distances(a, b).min() for b in shapes.values()] for a in shapes.values()])
    steps = [apart[order[:n], order[n]].min() for n in range(1, len(order))]
    # as distances of turned fields are the same both ways
    assert sum(steps) == pytest.approx(minimum_spanning_tree(np.triu(apart, 1)).sum())


def test_worse_frames_are_those_far_below_the_others():
    usual = np.array([5.0, 5.1, 4.9, 5.05, 4.95])
    assert not worse_than_usual(usual).any()
    assert worse_than_usual(np.append(usual, [4.2, np.nan, -np.inf])).tolist() == [False] * 5 + [True] * 3
    # a broad spread is normal itself
    assert not worse_than_usual(np.array([1.0, 2.0, 3.0, 4.0, 5.0])).any()


def test_a_frame_keeps_its_pose_where_the_one_before_leads_elsewhere(mixed, monkeypatch):
    """In the wrong order of time the tracker goes astray; with poses that are known none gets worse."""
    monkeypatch.setattr(advance, "search_frame", lambda tracker, surface, coarse, frame, *more: frame)
    task, actor, poses = mixed
    # two steps go astray more easily than the usual ones
    tracker, clouds = make_tracker(actor, iterations=2), [task.cloud(n) for n in task.scanned]
    before = [
        float(pose_log_density(tracker, pose, cloud)) for pose, cloud in zip(poses, clouds, strict=True)
    ]

    def likelihoods(known):
        frames = track_frames(tracker, clouds, poses[0], sigma=0.03, candidates=known)
        return [
            float(pose_log_density(tracker, f.pose, cloud)) for f, cloud in zip(frames, clouds, strict=True)
        ]

    assert np.min(np.subtract(likelihoods(None), before)) < -0.3
    assert np.min(np.subtract(likelihoods(lambda number: poses[number : number + 2]), before)) >= 0.0


def test_poses_without_an_order_are_found_and_kept(mixed, monkeypatch):
    """From the first pose alone, and again from all: no frame gets worse, and what an earlier run has done is taken up."""
    task, actor, poses = mixed
    searched = []

    def search(tracker, cloud, *, starts, **options):
        """A wide search that always succeeds."""
        searched.append(starts.scale.shape)
        return next(pose for n, pose in enumerate(poses) if task.cloud(n) is cloud), jnp.zeros(())

    monkeypatch.setattr(unordered, "initialise", search)
    first = dict.fromkeys(task.scanned, poses[0])
    *steps, (found, _) = find_poses(task, actor, first, is_known=False)
    tracker = make_tracker(actor)
    for n in task.scanned[1:]:
        assert found.likelihoods[n] > float(pose_log_density(tracker, poses[0], task.cloud(n)))
    halfway, done = steps[3]
    *_, (again, _) = find_poses(task, actor, first | halfway.poses, is_known=False, num_done=done)
    assert again.likelihoods == found.likelihoods
    # one that is far off, and has no neighbour that leads to it, is found by the wide search
    far = jc.Pose(poses[4].translations, poses[0].rotations, poses[4].scale)
    monkeypatch.setattr(unordered, "worse_than_usual", lambda likelihoods: np.arange(len(likelihoods)) == 4)
    *_, (second, _) = find_poses(task, actor, dict(enumerate(poses)) | {4: far}, is_known=True)
    assert set(searched) == {(24,)}
    for n in task.scanned:
        assert second.likelihoods[n] >= float(pose_log_density(tracker, poses[n], task.cloud(n)))


def test_nothing_in_a_plan_without_order_couples_frames(mixed):
    assert [stage.name for stage in plan_stages(UNORDERED)][-1] == "pose"
    assert not UNORDERED.smooth
    assert AdaptSettings().smooth
    task, actor, poses = mixed
    state = AdaptState(1, actor, 1.0, stack_poses(poses, 10.0), pose_weight=1e-8)
    assert append_history(task, state, "pose", [0]).terms[-1].temporal == 0.0
    ordered = task._replace(settings=AdaptSettings())
    assert append_history(ordered, state, "pose", [0]).terms[-1].temporal > 1e-3
    clouds = [task.cloud(n) for n in task.scanned]
    with pytest.raises(jc.InputError, match="leave these out .*--ordered"):
        make_adapt_task(task.template, clouds, settings=UNORDERED._replace(temporal_weight=1.0))


def test_frames_that_are_off_are_flagged_with_reasons(scene):
    """One with a limb elsewhere, one that is off by 12 mm, and one without a scan; the right ones are not."""
    task, (_, actor, poses, _) = task_of(scene), scene
    state = AdaptState(1, actor, 1.0, stack_poses(poses, 10.0))
    assert flag_frames(task, state, final=True).lost == ()
    skeleton, wrong = actor.skeleton, list(poses)
    turn = rotation.exp(jnp.asarray([0.0, 0.0, 1.0]))
    joint = skeleton.index("elbow")
    turns = poses[2].rotations.at[joint].set(rotation.multiply(poses[2].rotations[joint], turn))
    wrong[2] = jc.Pose(poses[2].translations, turns, poses[2].scale)
    wrong[5] = jc.Pose(poses[5].translations.at[0, 2].add(0.012), poses[5].rotations, poses[5].scale)
    found = flag_frames(task._replace(missing=(4,)), state._replace(motion=stack_poses(wrong, 10.0)))
    assert found.lost == (2, 4, 5)
    assert found.reasons[1] == NO_SCAN
    assert "unexplained points near the " in found.reasons[0]
    assert "mm from scan to body, compared with 0." in found.reasons[2]


def test_the_closing_lines_name_frames_with_their_reasons(mixed, capsys, tmp_path):
    task, actor, poses = mixed
    state = AdaptState(1, actor, 1.0, stack_poses(poses, 10.0), lost=(1, 4), reasons=("12 mm", NO_SCAN))
    for number in range(8):
        points = np.asarray(task.cloud(number).points)
        write_scan(tmp_path, number, points, points)
    warn_of_lost(state, read_clouds(str(tmp_path / "*.ply")))
    assert format_explained(state) == "6 of 8 scans explained"
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:] == ["jaxcap:   scan_0001.ply: 12 mm", f"jaxcap:   scan_0004.ply: {NO_SCAN}"]
    assert "2 of 8 frames are lost" in lines[0]
    assert format_explained(state._replace(lost=(), reasons=())) == "all scans explained"
    told = fails(capsys, "adapt", "human", tmp_path, "-o", tmp_path / "a.npz", "--unordered", "--ordered")
    assert "--unordered and --ordered are opposites" in told
    state = state._replace(others=(OtherPerson((3, 5), (("chest", -0.0072), ("thighs", 0.004)), 8),))
    warn_of_others(state, read_clouds(str(tmp_path / "*.ply")))
    (line,) = capsys.readouterr().err.splitlines()
    assert "2 of 8 compared scans may be of another person" in line and "scan_0003.ply, scan_0005.ply" in line
    assert "7.2 mm further in at the chest, 4.0 mm further out at the thighs" in line
    made = make_checkpoint(state)
    kept = restore_state(made, tmp_path / "kept")
    assert (kept.lost, kept.reasons, kept.others) == (state.lost, state.reasons, state.others)
    for damaged in ("[[[9], []]]", "[[0]]", "{", "[[[0], [[1, {}]]]]"):
        arrays = {**made.arrays, "others": np.array(damaged)}
        with pytest.raises(jc.InputError, match="kept"):
            restore_state(made._replace(arrays=arrays), tmp_path / "kept")


def test_a_distance_is_off_against_the_others():
    assert distance_limit(np.array([0.001, 0.0012, 0.0011])) == pytest.approx(0.0041)
    # where all are far off, so is the limit
    assert distance_limit(np.array([0.02, 0.021, 0.019])) == pytest.approx(0.03)
