"""What a window shows of files, and which frame when: without a window."""

import dataclasses
import time

import numpy as np
import pytest
from helpers import chain_body, chain_skeleton, random_pose

from jaxcap.body.body import Body, posed_vertices
from jaxcap.body.kinematics import joint_paths
from jaxcap.body.pose import Motion, Pose, stack_poses
from jaxcap.cli.track.frame_records import pack, pose_layout, row_template, row_width
from jaxcap.errors import InputError
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.checkpoint import Checkpoint, save_checkpoint
from jaxcap.io.archives.journal import create_journal, read_records, resume_journal
from jaxcap.io.archives.limits import FORMAT as LIMITS
from jaxcap.io.archives.npz import save_body, save_motion
from jaxcap.io.archives.prior import FORMAT as PRIOR
from jaxcap.io.cameras import write_cameras
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.markers.subject import save_subject
from jaxcap.io.meshes.clouds import NO_FACES, Scans
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.meshes.meshes import save_meshes
from jaxcap.io.registry import write_markers
from jaxcap.io.skeletons.bvh import write_bvh
from jaxcap.io.skeletons.skl import write_skl
from jaxcap.io.table import write_json
from jaxcap.markers.subject import make_subject
from jaxcap.metrics import scan_to_surface
from jaxcap.observe.markers import make_markers
from jaxcap.observe.meshes import MeshSequence
from jaxcap.tracking.track_frame import make_tracker
from jaxcap.view import live
from jaxcap.view.contents import Contents, make_take
from jaxcap.view.figures.clouds import DisplayCloud, DisplayClouds
from jaxcap.view.figures.posing import CHUNK_FRAMES, PosedMotion
from jaxcap.view.figures.scan_colours import (
    NUM_BANDS,
    heat_classes,
    heat_palette,
    make_part_colours,
    posterior_colours,
    scan_heat,
)
from jaxcap.view.live import RunFollower, follow_run, record_poses
from jaxcap.view.load import load
from jaxcap.view.windows.column import _match_scans
from jaxcap.view.windows.timeline import Timeline


@pytest.fixture(scope="module")
def body() -> Body:
    return chain_body()


@pytest.fixture(scope="module")
def motion(body) -> Motion:
    rng = np.random.default_rng(1)
    return stack_poses([random_pose(body.skeleton, rng, 0.3) for _ in range(2 * CHUNK_FRAMES + 5)], rate=60.0)


def test_a_body_and_its_motion_meet(tmp_path, body, motion):
    save_body(tmp_path / "body.npz", body)
    save_motion(tmp_path / "motion.npz", motion, body.skeleton)
    found = load([str(tmp_path / "motion.npz"), str(tmp_path / "body.npz")])
    (take,) = found.takes
    assert take.motion.body is not None and not take.is_still
    assert (found.frames, found.rate) == (len(motion), 60.0)
    # a body that no motion is of stands at rest
    (alone,) = load([str(tmp_path / "body.npz")]).takes
    assert alone.is_still and alone.motion.body is not None


def test_a_skinned_file_is_a_body_with_its_motion(tmp_path, motion, body):
    write_gltf(tmp_path / "moving.glb", body, motion)
    write_gltf(tmp_path / "still.glb", body)
    save_motion(tmp_path / "motion.npz", motion, body.skeleton)
    (take,) = load([str(tmp_path / "moving.glb")]).takes
    places = np.asarray(posed_vertices(body, motion.poses))
    for frame in range(len(motion)):
        np.testing.assert_allclose(take.motion.frame(frame).vertices, places[frame], atol=1e-5)
    # without an animation it is the body of motions beside it
    (take,) = load([str(tmp_path / "still.glb"), str(tmp_path / "motion.npz")]).takes
    assert take.motion.body is not None
    assert len(take.motion) == len(motion)


def test_a_motion_without_a_body_is_its_skeleton(tmp_path, motion, body):
    write_bvh(tmp_path / "take.bvh", body.skeleton, motion)
    (take,) = load([str(tmp_path / "take.bvh")]).takes
    assert take.motion.body is None
    assert set(body.skeleton.names) <= set(take.motion.skeleton.names)


def test_a_motion_of_another_body_names_both(tmp_path, motion, body):
    other = stack_poses([random_pose(chain_skeleton(), np.random.default_rng(0))])
    poses = Pose(other.poses.translations[:, :4], other.poses.rotations[:, :4], other.poses.scale)
    other = Motion(poses)
    save_motion(tmp_path / "other.npz", other)
    with pytest.raises(InputError, match=r"other\.npz: this motion .* 4 joints"):
        load([str(tmp_path / "other.npz")], [("the body", body)])
    with pytest.raises(InputError, match="skeleton; give its body by --body"):
        load([str(tmp_path / "other.npz")])
    save_motion(tmp_path / "still.npz", motion.slice(slice(0, 0)), body.skeleton)
    for bodies in ([], [("the body", body)]):
        with pytest.raises(InputError, match=r"still\.npz: there are no frames in this motion"):
            load([str(tmp_path / "still.npz")], bodies)
    np.savez(tmp_path / "clouds.npz", points=np.zeros((0, 4, 3)))
    with pytest.raises(InputError, match=r"clouds\.npz: there are no frames"):
        load([str(tmp_path / "clouds.npz")])


def test_every_file_that_the_library_writes(tmp_path, body, motion, rng):
    skeleton = body.skeleton
    markers = make_markers(rng.uniform(size=(4, 3, 3)), ("a", "b", "c"), 100.0)
    write_markers(tmp_path / "markers.csv", markers)
    write_markers(tmp_path / "markers.trc", markers)
    write_markers(tmp_path / "markers.c3d", markers)
    save_subject(
        tmp_path / "subject.npz", make_subject(skeleton, [0, 1, 2], rng.uniform(size=(3, 3)), ("a", "b", "c"))
    )
    write_skl(tmp_path / "a.skl", skeleton)
    write_mesh(tmp_path / "mesh.ply", Mesh(np.asarray(body.vertices), np.asarray(body.faces)))
    write_mesh(tmp_path / "cloud.off", Mesh(rng.uniform(size=(9, 3)), np.zeros((0, 3), int)))
    save_meshes(
        tmp_path / "meshes.npz", MeshSequence(rng.uniform(size=(3, 4, 3)), np.array([[0, 1, 2]]), 25.0)
    )
    np.savez(tmp_path / "clouds.npz", points=rng.uniform(size=(5, 8, 3)))
    write_cameras(tmp_path / "cameras.json", [look_at([0, 1, 3], [0, 1, 0], 64, 48, 50)])
    save_checkpoint(tmp_path / "kept.npz.partial", Checkpoint(body, motion, (), {}), {})
    write_json(tmp_path / "report.json", {"mean": 1.0})
    (tmp_path / "report.html").write_text("<p>")
    names = sorted(path.name for path in tmp_path.iterdir())
    found = load([str(tmp_path / name) for name in names])
    assert [len(one.frames) for one in found.markers] == [4, 4, 4]
    assert sorted((len(m.vertices), len(m.faces)) for m in found.meshes) == [
        (1, 0),
        (1, len(body.faces)),
        (3, 1),
    ]
    assert [len(clouds) for clouds in found.clouds] == [5]
    assert len(found.cameras) == 1
    kinds = {take.name: (take.motion.body is not None, take.subject is not None) for take in found.takes}
    assert kinds == {"kept.npz.partial": (True, False), "subject.npz": (False, True), "a.skl": (False, False)}
    assert len(found.notes) == 2
    assert all("report" in told for told in found.notes)


@pytest.mark.parametrize(("kind", "why"), [(LIMITS, "joint limits"), (PRIOR, "pose prior"), ("", "loss")])
def test_what_has_no_shape_gets_a_sentence(tmp_path, kind, why):
    np.savez(tmp_path / "numbers.npz", loss=np.zeros(3), **({"format": kind} if kind else {}))
    found = load([str(tmp_path / "numbers.npz")])
    assert found.is_empty and why in found.notes[0]


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("take.pts", b"1", "a point cloud as text, which is not read; convert it to .ply"),
        ("half.npz", b"PK\x03\x04half", "this .npz file is incomplete"),
        ("half.bvh", b"HIERARCHY\nROOT a\n{", "half.bvh"),
        ("cameras.json", b'{"cameras": []}', "at least one camera"),
    ],
)
def test_wrong_files_are_told(tmp_path, name, content, why):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=why):
        load([str(tmp_path / name)])
    with pytest.raises(InputError, match="no such file"):
        load([str(tmp_path / "nothing.npz")])


def test_a_run_finds_the_scans_it_saw(tmp_path, body, motion):
    run = tmp_path / "run"
    run.mkdir()
    save_motion(run / "motion.npz", motion.slice(slice(0, 2)), body.skeleton)
    rows = [{"cloud": "scan2.ply", "sigma": 0.01}, {"cloud": "scan3.ply", "sigma": 0.02}]
    write_json(run / "statistics.json", {"rate": 30.0, "frames": rows})
    (take,) = load([str(run)], [("body", body)]).takes
    assert take.name == "run" and take.sigmas == (0.01, 0.02)
    clouds = DisplayClouds(
        Scans([f"/far/scan{i}.ply" for i in range(5)], lambda i: (np.zeros((3, 3)), None, NO_FACES))
    )
    assert _match_scans(take, clouds) == {0: 2, 1: 3}


def test_chunks_are_the_frames(body, motion):
    posed = PosedMotion(body.skeleton, body, motion.poses)
    vertices = np.asarray(posed_vertices(body, motion.poses))
    joints = np.asarray(joint_paths(body.skeleton, motion.poses))
    for frame in (0, CHUNK_FRAMES - 1, CHUNK_FRAMES, len(motion) - 1, 3):
        np.testing.assert_allclose(posed.frame(frame).vertices, vertices[frame], atol=1e-6)
        np.testing.assert_allclose(posed.frame(frame).joints, joints[frame], atol=1e-6)
    posed._most = 1
    posed.frame(0)
    assert len(posed._chunks) <= 2


def test_a_motion_grows_under_the_eye(body, motion):
    posed = PosedMotion(body.skeleton, None, motion.slice(slice(0, 1)).poses)
    posed.frame(0)
    before = posed.version
    posed.extend(motion.slice(slice(1, 40)).poses)
    joints = np.asarray(joint_paths(body.skeleton, motion.poses))
    for frame in (0, 1, 39):
        np.testing.assert_allclose(posed.frame(frame).joints, joints[frame], atol=1e-6)
    assert (len(posed), posed.version > before) == (40, True)


def _record(tracker, motion, frame) -> np.ndarray:
    template = row_template(tracker)
    return pack(dataclasses.replace(template, pose=motion[frame], lost=True), 0.5)


def test_a_journal_tells_the_poses(tmp_path, body, motion):
    tracker, whose = make_tracker(body), pose_layout(body.skeleton)
    follower = RunFollower(follow_run(tmp_path, body))
    assert not follower.poll()
    with create_journal(tmp_path / "journal", {"a": 1, **whose}, row_width(row_template(tracker))) as journal:
        assert not follower.poll()
        for frame in range(3):
            journal.append(_record(tracker, motion, frame))
        assert follower.poll() and len(follower.take.motion) == 3
        # one that is being written is not there yet
        whole = _record(tracker, motion, 3).tobytes()
        with open(journal.path, "ab") as file:
            file.write(whole[:100])
        assert not follower.poll() and len(read_records(journal.path)) == 3
    with resume_journal(tmp_path / "journal", {"a": 1, **whose}, row_width(row_template(tracker))) as journal:
        journal.append(_record(tracker, motion, 4))
        follower.poll()
    joints = np.asarray(joint_paths(body.skeleton, motion.poses))
    for shown, frame in ((2, 2), (3, 4)):
        np.testing.assert_allclose(follower.take.motion.frame(shown).joints, joints[frame], atol=1e-5)
    # begun anew, and with another body
    create_journal(tmp_path / "journal", {"a": 2, **whose}, row_width(row_template(tracker))).close()
    with resume_journal(tmp_path / "journal", {"a": 2, **whose}, row_width(row_template(tracker))) as journal:
        journal.append(_record(tracker, motion, 7))
    assert follower.poll() and len(follower.take.motion) == 1
    with pytest.raises(InputError, match="another body"):
        record_poses(tmp_path, body.skeleton, {"joints": ["a"], "pose at": 1}, np.zeros((1, 12)))
    with pytest.raises(InputError, match="not of a run of jaxcap track"):
        record_poses(tmp_path, body.skeleton, {}, np.zeros((1, 12)))


def test_what_is_wrong_with_a_run_is_told_until_it_is_mended(tmp_path, body, motion, monkeypatch):
    monkeypatch.setattr(live, "POLL_SECONDS", 0.01)
    tracker, whose = make_tracker(body), pose_layout(body.skeleton)
    with create_journal(tmp_path / "journal", whose, row_width(row_template(tracker))) as journal:
        journal.append(_record(tracker, motion, 0))
    follower = RunFollower(follow_run(tmp_path, body))
    other = {**whose, "joints": ["a"]}
    with create_journal(tmp_path / "journal", other, row_width(row_template(tracker))) as journal:
        journal.append(_record(tracker, motion, 0))
    for _ in range(2):
        with pytest.raises(InputError, match="another body"):
            follower.poll()
    follower.start()
    _until(lambda: "another body" in follower.error)
    # a fault of another kind does not end the thread
    with monkeypatch.context() as broken:
        broken.setattr(live, "read_header", lambda path: 1 / 0)
        _until(lambda: "could not be read (ZeroDivisionError" in follower.error)
    with create_journal(tmp_path / "journal", whose, row_width(row_template(tracker))) as journal:
        for frame in range(2):
            journal.append(_record(tracker, motion, frame))
    _until(lambda: follower.error == "" and len(follower.take.motion) == 2)
    follower.stop()


def _until(happened) -> None:
    end = time.monotonic() + 20.0
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_an_unfinished_run_asks_for_its_body(tmp_path, body, motion):
    tracker = make_tracker(body)
    with create_journal(
        tmp_path / "journal", pose_layout(body.skeleton), row_width(row_template(tracker))
    ) as journal:
        journal.append(_record(tracker, motion, 0))
    with pytest.raises(InputError, match="--body"):
        load([str(tmp_path)])
    # one that was stopped has both; it is followed where that is asked for
    save_motion(tmp_path / "motion.npz", motion, body.skeleton)
    assert load([str(tmp_path)]).takes[0].run_folder is None
    assert load([str(tmp_path)], [("body", body)], follow=True).takes[0].run_folder == tmp_path
    (tmp_path / "motion.npz").unlink()
    np.savez(tmp_path / "clouds.npz", points=np.zeros((9, 4, 3)))
    found = load([str(tmp_path)], [("body", body)], [str(tmp_path / "clouds.npz")])
    assert found.takes[0].run_folder == tmp_path and len(found.takes[0].motion) == 1
    # its end is the last frame solved, whatever scans wait
    assert found.frames == 1


def test_a_window_may_wait_for_a_run(tmp_path, body):
    with pytest.raises(InputError):
        load([str(tmp_path)], [("body", body)])
    for folder in (tmp_path, tmp_path / "later"):
        (take,) = load([str(folder)], [("body", body)], follow=True).takes
        assert take.run_folder == folder and not take.is_still


def test_the_timeline_leaves_frames_out_and_is_never_late():
    line = Timeline(frames=100, rate=30.0)
    assert line.frame(5.0) == 0 and line.wait(5.0) == np.inf
    line.play(10.0)
    assert [line.frame(10.0 + t) for t in (0.0, 0.01, 0.05, 1.0, 3.31)] == [0, 0, 1, 30, 99]
    assert line.frame(10.0 + 100 / 30 + 0.05) == 1  # from the first on again
    assert line.wait(10.01) == pytest.approx(1 / 30 - 0.01)
    line.set_speed(0.5, 11.0)
    assert line.frame(12.001) == 45
    line.pause(12.001)
    assert line.frame(99.0) == 45
    line.seek(1_000, 99.0)
    assert line.frame(99.0) == 99
    line.play(100.0)
    assert line.frame(100.0) == 0
    line.grow(10, 102.0)
    assert line.frame(102.0) <= 9


def test_heat_is_the_distance_of_the_scan(body, rng):
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    points = vertices[:20] + 0.05 * rng.normal(size=(20, 3))
    heat = scan_heat(DisplayCloud("scan", points, None), vertices, faces)
    np.testing.assert_allclose(heat.distances, scan_to_surface(points, vertices, faces))
    known = np.isfinite(heat.vertices)
    assert known.any() and not known.all()
    assert heat.vertices[known].max() <= heat.distances.max() + 1e-12
    # a body without faces is its vertices
    bare = scan_heat(DisplayCloud("scan", points, None), vertices, faces[:0])
    nearest = np.linalg.norm(points[:, None] - vertices, axis=2).min(1)
    np.testing.assert_allclose(bare.distances, nearest)


def test_bands_hold_what_the_legend_says():
    limit = 0.012
    heat = np.array([0.0, 0.00099, 0.00101, 0.0119, 5.0, np.nan])
    np.testing.assert_array_equal(heat_classes(heat, limit), [0, 0, 1, 11, 11, NUM_BANDS])
    assert heat_palette().shape == (NUM_BANDS + 1, 3)
    assert len(np.unique(heat_palette(), axis=0)) == NUM_BANDS + 1
    # one for all frames
    assert heat_palette() is heat_palette() and not heat_palette().flags.writeable


@pytest.mark.parametrize("faces", [True, False])
def test_points_on_a_part_have_its_colour(body, faces):
    body = body if faces else Body(body.skeleton, body.skin, body.vertices, body.faces[:0])
    colours = make_part_colours(body)
    assert len(np.unique(colours.palette, axis=0)) == body.skeleton.num_joints + 1
    vertices = np.asarray(body.vertices)
    far = np.array([[5.0, 5.0, 5.0]])
    cloud = DisplayCloud("scan", np.concatenate([vertices, far]), np.zeros((len(vertices) + 1, 3)))
    points, mixed = posterior_colours(colours, vertices, cloud, sigma=1e-4)
    tree = np.linalg.norm(points[:, None] - vertices, axis=2)
    on = tree.min(1) < 1e-6
    expected = colours.palette[colours.vertices[tree.argmin(1)]]
    assert on.sum() == len(vertices)
    assert np.abs(mixed[on].astype(int) - expected[on]).max() <= 3
    np.testing.assert_array_equal(mixed[~on][0], colours.palette[-1])


def test_scans_are_thinned_turned_and_kept():
    reads = []

    def read(frame):
        reads.append(frame)
        return np.tile(np.arange(50.0)[:, None], (1, 3)), None, NO_FACES

    clouds = DisplayClouds(
        Scans(["a", "b"], read), upright_rotation=np.diag([1.0, -1.0, -1.0]), max_points=10
    )
    first = clouds[0]
    assert len(first.points) == 10 and clouds[0] is first and reads == [0]
    np.testing.assert_array_equal(first.points[:, 1], -first.points[:, 0])


def test_contents_are_as_long_as_their_longest(body, motion):
    take = make_take("slow", body.skeleton, body, Motion(motion.slice(slice(0, 10)).poses, 10.0))
    fast = make_take("fast", body.skeleton, None, motion)
    assert Contents(takes=[take, fast]).rate == 10.0
    assert Contents(takes=[take, fast]).frames == round(len(motion) / 6)
    poses = motion[0]
    short = Pose(poses.translations[:3], poses.rotations[:3], poses.scale)
    with pytest.raises(ValueError, match="3 joints"):
        make_take("short", body.skeleton, None, short)
