"""What users give an adaptation that cannot go well, or not whole: one sentence that says so, before hours are spent."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import FRAMES, POINTS, make_scene, task_of, words, write_folder, write_scan
from command_line import fails, runs

import jaxcap as jc
from jaxcap.adapt import check_scans
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.check_scans import (
    FitQuality,
    check_actor,
    connected_labels,
    fit_quality,
    height_of,
    is_person,
    person_sized_groups,
)
from jaxcap.adapt.evaluate import compare_stages
from jaxcap.adapt.poses.fit_frame import pairs_of
from jaxcap.adapt.task import AdaptSettings, AdaptState, AdaptTask, plan_stages
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.retraction import difference
from jaxcap.cli.adapt.adapt import Adapt
from jaxcap.cli.adapt.input import check_input, check_people
from jaxcap.cli.adapt.state import fingerprint_of, keep_state, load_resumed_state
from jaxcap.energy.data.pairs import stack_pairs
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.correspondence.nearest_assignment import NearestOnSurface, make_scan
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.prior.pair_prior import successive_pairs

_posed = eqx.filter_jit(jc.pose_body)


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture
def folder(scene, tmp_path):
    return write_folder(tmp_path, scene)


def there(body: jc.Body, pose: jc.Pose) -> AdaptState:
    """As the stage `size` leaves it."""
    return AdaptState(1, body, 1.0, stack_poses([pose], 10.0))


def alone(task: AdaptTask, points, normals=None) -> AdaptTask:
    cloud = jc.make_cloud(points, normals)
    return task._replace(cloud=lambda _: cloud, num_frames=1)


@pytest.mark.parametrize(
    "told", ["--pair-angle 0 above 0", "--pair-distance -1 above 0", "--pose-weight -1 at least 0"]
)
def test_amounts_that_are_none(folder, capsys, told):
    name, value, what = told.split(" ", 2)
    assert f"{name} is {value}; it must be {what}" in fails(capsys, *words(folder, name, value))
    assert "--shape-weight is 0; it must be above 0" in fails(capsys, *words(folder, "--shape-weight", 3, 0))
    assert "--ignore-occlusion needs cameras" in fails(capsys, *words(folder, "--ignore-occlusion"))


def test_settings_are_what_was_asked(folder, scene):
    scans = read_clouds(str(folder / "*.ply"))
    names = str(folder / "body.npz"), (str(folder / "*.ply"),), folder / "a.npz"
    asked = Adapt(*names, assignment="surface", pair_distance=0.1, pose_weight=1e-8, shape_weight=(9.0, 2.0))
    asked.ignore_occlusion, asked.cameras = True, folder / "cameras.json"
    task = asked.task(scene[0], scans, asked.read_files(scene[0], None, None))
    assert (task.settings.pose_weight, task.settings.shape_weights) == (1e-8, (9.0, 2.0))
    assert isinstance(task.settings.matching.assignment, NearestOnSurface)
    assert task.settings.matching.max_distance == 0.1
    assert len(task.settings.matching.aperture) == 4
    assert task.cameras == ()


def test_a_body_and_a_motion_of_one_name(folder, capsys):
    told = fails(capsys, *words(folder, "--motion", folder / "a.npz"))
    assert "a.npz: body and motion cannot be one file; give --motion another name" in told


def test_scans_of_other_sizes_are_stacked(scene):
    """Pairs of a scan with few points are padded to those of one with many."""
    _, actor, poses, clouds = scene
    task = task_of(scene)
    scans = [make_scan(jc.make_cloud(clouds[0][0][:count])) for count in (POINTS, 200)]
    parts = [pairs_of(actor, poses[0], scan, task.settings.matching) for scan in scans]
    assert len(parts[0].weights) > len(parts[1].weights)
    both = stack_pairs(parts)
    np.testing.assert_allclose(both.weights.sum(1), [part.weights.sum() for part in parts])
    assert not both.weights[1, len(parts[1].weights) :].any()


def test_scans_that_cannot_be_used_are_named(folder, scene, capsys):
    template, _, _, clouds = scene
    points, normals = clouds[0]
    scans = read_clouds(str(folder / "*.ply"))
    write_scan(folder, 2, points[:0], normals[:0])
    write_scan(folder, 4, 1000 * points, normals)
    found, digests = check_input(scans, template)
    assert list(found) == [2, 4]
    assert len(set(digests)) == FRAMES
    assert "scan_0002.ply: it has no points" in found[2]
    assert "scan_0004.ply is" in found[4] and "millimetres" in found[4]
    (folder / "scan_0001.ply").write_bytes(b"")
    write_scan(folder, 3, points[:5], normals[:5])
    told = fails(capsys, *words(folder))
    assert "4 of 6 scans cannot be used" in told and "scan_0001.ply" in told
    write_scan(folder, 0, points[:0], normals[:0])
    assert "scan_0000.ply: it has no points" in fails(capsys, *words(folder))
    assert not list(folder.glob("a*"))


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres")])
def test_scans_in_another_unit(scene, folder, capsys, factor, unit):
    for number, (points, normals) in enumerate(scene[3]):
        write_scan(folder, number, factor * points, normals)
    assert f"looks like {unit}" in fails(capsys, *words(folder))


def test_metres_that_are_taken_for_millimetres(folder, capsys):
    assert "check the units of both" in fails(capsys, *words(folder, "--unit", "mm"))


def without_second(task: AdaptTask) -> AdaptTask:
    """The same task where the scan of frame 2 is not there, nor asked for."""

    def cloud(frame: int) -> jc.Cloud:
        assert frame != 2
        return task.cloud(frame)

    return task._replace(cloud=cloud, missing=(2,))


def test_a_frame_without_a_scan_is_lost_and_lies_between_others(scene):
    task = without_second(task_of(scene, template=scene[1]))
    *_, last = adapt_body(task._replace(settings=AdaptSettings(proportion_rounds=0, rounds=())))
    assert last.lost == (2,)
    skeleton, motion = last.body.skeleton, last.motion
    ways = [difference(skeleton, motion[a], motion[b]) for a, b in ((1, 2), (2, 3))]
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-6)
    assert float(jnp.abs(ways[0]).max()) > 1e-3


@pytest.mark.slow
def test_all_stages_go_without_it(scene):
    task = without_second(task_of(scene))
    states = list(adapt_body(task))
    assert all(2 not in state.chosen for state in states)
    assert any(state.chosen for state in states)
    *_, stages = compare_stages(task, states[-1])
    assert stages.measured_frames == (0, 1, 3, 4, 5)


def test_something_else_than_the_body(scene, monkeypatch):
    """The right body explains its scan, with a small thing beside it, and no ball."""
    _, actor, poses, clouds = scene
    rng, task, state = np.random.default_rng(1), task_of(scene), there(actor, poses[0])
    thing = np.array([0.6, 0.1, 0.0]) + rng.uniform(-0.1, 0.1, (80, 3))
    with_thing = alone(
        task, *(np.concatenate(parts) for parts in ((clouds[0][0], thing), (clouds[0][1], thing)))
    )
    check_actor(with_thing, state, "a.ply")
    middle, height = clouds[0][0].mean(0), height_of(actor)
    out = rng.normal(size=(900, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # no other person is looked for in it
    monkeypatch.setattr(check_scans, "_fit_quality_alone", lambda *_: FitQuality(0.0, 0.0))
    with pytest.raises(
        jc.InputError, match=r"a\.ply: this scan does not resemble a person.*give scans of one person"
    ):
        check_actor(alone(task, middle + 0.4 * height * out, out), state, "a.ply")
    monkeypatch.setattr(check_scans, "_fit_quality_alone", lambda *_: FitQuality(0.9, 0.9))
    column = (
        middle
        + [0.8 * height, 0.0, 0.0]
        + 0.5 * height * rng.uniform([-0.1, -1, -0.1], [0.1, 1, 0.1], (900, 3))
    )
    with pytest.raises(jc.InputError, match="this scan contains more than one person, another one near"):
        check_actor(alone(task, np.concatenate([clouds[0][0], column])), state, "a.ply")


def test_a_second_person_in_a_later_scan(scene, monkeypatch):
    """The scan is named, and an object that stays in its position is compared with a person once."""
    _, actor, poses, clouds = scene
    rng, height, compared = np.random.default_rng(1), height_of(actor), []
    size = 0.5 * height * rng.uniform([-0.1, -1, -0.1], [0.1, 1, 0.1], (900, 3))
    column = clouds[0][0].mean(0) + [0.8 * height, 0.0, 0.0] + size

    def cloud(frame: int) -> jc.Cloud:
        parts = [clouds[frame], (column, np.zeros_like(column))][: 2 if frame in (3, 4) else 1]
        return jc.make_cloud(*map(np.concatenate, zip(*parts, strict=True)))

    def like(share: float):
        monkeypatch.setattr(
            check_scans, "_fit_quality_alone", lambda *_: compared.append(0) or FitQuality(share, 0.9)
        )

    task = task_of(scene)._replace(cloud=cloud)
    names = [f"{number}.ply" for number in range(FRAMES)]
    state = AdaptState(2, actor, 1.0, stack_poses(poses, 10.0))
    like(0.1)
    check_people(task, state, names)
    assert len(compared) == 1
    like(0.9)
    check_people(task, state._replace(within=4), names)
    check_people(task, state._replace(done=3), names)
    # a body that has lost its person
    away = jc.Pose(poses[0].translations + 5.0, poses[0].rotations, poses[0].scale)
    lost = state._replace(motion=stack_poses([away] * FRAMES, 10.0))
    check_people(task, lost, names)
    with pytest.raises(jc.InputError, match=r"3\.ply: this scan contains more than one.*--skip-person-check"):
        check_people(task, state, names)


def test_what_a_body_explains_of_its_own_surface_and_of_one_inside_out(scene):
    _, actor, poses, _ = scene
    state, posed = there(actor, poses[0]), _posed(actor, poses[0])
    points, normals = np.asarray(posed.vertices), np.asarray(posed.normals)
    shares = [
        fit_quality(state, 0, make_scan(jc.make_cloud(points, sign * normals)))[0].share
        for sign in (1, -1, 0)
    ]
    assert shares == [1.0, 0.0, 1.0]
    far, apart = fit_quality(state, 0, make_scan(jc.make_cloud(points + 10.0, normals)))
    assert far == FitQuality(0.0, 0.0)
    assert len(apart) == len(points)


def test_what_a_human_explains_of_its_own_scan():
    body, rng = jc.human(resolution="low", joints="tracking"), np.random.default_rng(0)
    pose, faces = rest_pose(body.skeleton), np.asarray(body.faces)
    points, normals = sample_surface(np.asarray(_posed(body, pose).vertices, float), faces, 2500, rng)
    found = [
        fit_quality(there(body, pose), 0, make_scan(jc.make_cloud(points, sign * normals)))[0].share
        for sign in (1, -1)
    ]
    assert found[0] > 0.95
    assert found[1] < 0.05


@pytest.mark.parametrize(
    ("share", "length", "person"),
    [
        # somebody in other clothes, sitting, curled up and half seen, with a large sack on the back
        *[(0.70, 0.88, True), (0.90, 0.71, True), (0.63, 0.45, True), (0.48, 0.95, True)],
        # boxes, a post, a column, a cone, a tree, a chair, a wall: as they were measured
        *[(0.60, 0.62, False), (0.51, 0.66, False), (0.46, 0.81, False), (0.59, 0.63, False), (0.52, 0.56, False)],
        *[(0.43, 0.64, False), (0.25, 0.73, False), (0.12, 1.01, False)],
    ],
)  # fmt: skip
def test_who_is_a_person(share, length, person):
    assert is_person(FitQuality(share, length)) == person


def test_groups_are_those_as_large_as_a_person():
    """Of a wall, a small box, a floor and a column of a person's size only the last may be a person."""
    rng = np.random.default_rng(0)
    column = rng.uniform([-0.2, 0, -0.2], [0.2, 1.7, 0.2], (3000, 3))
    wall = rng.uniform([-2, 0, 3], [2, 2.4, 3.02], (4000, 3))
    box = rng.uniform([1, 0, 0], [1.4, 0.4, 0.4], (1000, 3))
    points = np.concatenate([wall, box, column])
    groups = person_sized_groups(points, 1.75, len(points))
    assert [rows.tolist() for rows in groups] == [list(range(5000, 8000))]
    assert person_sized_groups(column, 1.75, 100_000) == []
    assert person_sized_groups(column[:0], 1.75, 100) == []
    labels = connected_labels(points, 0.1)
    assert len(np.unique(labels)) == 3


@pytest.mark.slow
@pytest.mark.parametrize("two", [True, False])
def test_two_people_in_a_scan(two):
    """Another person is told from a column of that size by the body, which explains the one and not the other."""
    body, rng = jc.human(resolution="low", joints="tracking"), np.random.default_rng(0)
    other = jc.human(resolution="low", joints="tracking", sex="female", height=1.6)
    pose, faces = rest_pose(body.skeleton), np.asarray(body.faces)
    points, _ = sample_surface(np.asarray(_posed(body, pose).vertices, float), faces, 2500, rng)
    if two:
        more, _ = sample_surface(np.asarray(_posed(other, pose).vertices, float), faces, 2500, rng)
    else:
        angle, up = rng.uniform(0, 2 * np.pi, 2500), rng.uniform(-0.8, 0.8, 2500)
        more = np.stack([0.35 * np.cos(angle), up, 0.35 * np.sin(angle)], 1)
    task = AdaptTask(body, lambda _: jc.make_cloud(points), 1, 30.0, pose, RestPrior(jnp.full((body.skeleton.num_joints, 3), 0.7)), (), AdaptSettings())  # fmt: skip
    task = alone(task, np.concatenate([points, more + [1.6, 0.0, 0.0]]))
    if two:
        with pytest.raises(jc.InputError, match="more than one person"):
            check_actor(task, there(body, pose), "a.ply")
    else:
        check_actor(task, there(body, pose), "a.ply")


def test_a_disk_that_is_full(scene, tmp_path, monkeypatch):
    """What was kept before is there to the last bit, and nothing beside it."""
    path, header = tmp_path / "a.npz.partial", {"frames": 3}
    template, _, poses, _ = scene
    state = AdaptState(1, template, 1.0, stack_poses(poses, 10.0), history=(("size", 4.0),))
    keep_state(path, state, header)
    before, whole = path.read_bytes(), np.savez_compressed

    def full(file, **arrays):
        whole(file, **arrays)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    for later in (state._replace(done=2), state._replace(within=2)):
        with pytest.raises(
            jc.InputError, match=r"No space left.*free some disk space.*1 stage is saved.*--resume"
        ):
            keep_state(path, later, header)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    kept = load_resumed_state(path, header, resume=True, overwrite=False)
    assert kept is not None and kept.done == 1


def test_results_for_which_there_is_no_space(scene, folder, capsys, monkeypatch):
    """All stages are done; what cannot be written is written by --resume."""
    template, actor, poses, _ = scene
    task = Adapt(str(folder / "body.npz"), (str(folder / "*.ply"),), folder / "a.npz", smoothness=0.0)
    digests = check_input(read_clouds(task.clouds), template).digests
    header = {**task.settings(), "prior": None, **fingerprint_of(template, digests)}
    state = AdaptState(len(plan_stages(AdaptSettings(temporal_weight=0.0))), actor, 1.1, stack_poses(poses, 30.0), history=(("pose", 1.0),))  # fmt: skip
    keep_state(task.checkpoint_path, state, header)

    def full(file, **arrays):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(np, "savez_compressed", full)
        told = fails(capsys, *words(folder, "--smoothness", 0, "--resume"))
    assert "a-motion.npz: cannot be written" in told and "stages are saved" in told
    assert not task.out.exists()
    assert "times the template's size" in runs(capsys, *words(folder, "--smoothness", 0, "--resume"))
    assert not task.checkpoint_path.exists()


def test_a_folder_that_cannot_be_written_to(folder, capsys):
    """It is told at once, not after the first stage."""
    told = fails(capsys, "adapt", folder / "body.npz", folder / "*.ply", "-o", folder / "body.npz" / "a.npz")
    assert "body.npz: this folder cannot be written to" in told


def test_a_prior_of_another_skeleton(scene, folder, capsys):
    skeleton = replace(
        scene[0].skeleton, names=tuple(f"other{n}" for n in range(len(scene[0].skeleton.names)))
    )
    pairs = successive_pairs(skeleton)[:1]
    frames = [[skeleton.orientations[skeleton.index(name)] for name in pair] for pair in pairs]
    prior = jc.prior.make_pair_prior(
        pairs, np.array(frames), np.ones((1, 1)), np.zeros((1, 1, 6)), np.eye(6)[None, None]
    )
    jc.io.save_prior(folder / "prior.npz", prior)
    told = fails(capsys, *words(folder, "--prior", folder / "prior.npz"))
    assert "prior.npz: this prior belongs to another skeleton: there is no joint 'other" in told
    assert "learn a prior for this skeleton" in told
