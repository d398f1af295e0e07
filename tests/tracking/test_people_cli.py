"""`jaxcap track --people`: a folder for each person, refusals, and a stopped run."""

import dataclasses
import json

import equinox as eqx
import numpy as np
import pytest
from command_line import FRAMES, fails, runs, write_inputs

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import rest_pose, shift_roots
from jaxcap.cli import main
from jaxcap.cli.sources import load_body
from jaxcap.cli.track import person_shape
from jaxcap.cli.track.frame_records import pack
from jaxcap.cli.track.people import people_template
from jaxcap.cli.track.people_deviations import divide_clouds
from jaxcap.io.archives.journal import Journal
from jaxcap.io.archives.npz import load_motion
from jaxcap.io.lazy_frames import LazyFrames
from jaxcap.observe.clouds import make_cloud
from jaxcap.tracking import advance
from jaxcap.tracking.track_frame import make_tracker, start_state

DISTANCE = 1.4


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Clouds of a small human, and of the same one with a second one next to it from the third frame on."""
    folder = write_inputs(tmp_path_factory.mktemp("people"))
    with np.load(folder / "clouds.npz") as file:
        points, normals = file["points"], file["normals"]
    second = points + [DISTANCE, 0.0, 0.0]
    # before, the points of the second person are those of the first
    second[:2] = points[:2]
    np.savez(
        folder / "both.npz",
        points=np.concatenate([points, second], axis=1),
        normals=np.concatenate([normals, normals], axis=1),
    )
    return folder


def command(inputs, out, *more):
    return ["track", inputs / "body.npz", inputs / "both.npz", "-o", out, "--initialise", "never", *more]


@pytest.fixture(scope="module")
def finished(inputs):
    out = inputs / "whole"
    main([str(word) for word in command(inputs, out, "--people", "2")])
    return out


def test_each_person_has_a_folder(inputs, finished):
    truth = load_motion(inputs / "truth.npz")
    assert {path.name for path in finished.iterdir()} == {"journal", "person_1", "person_2"}
    for number in (1, 2):
        folder = finished / f"person_{number}"
        names = {path.name for path in folder.iterdir()}
        assert names == {"motion.bvh", "motion.npz", "statistics.csv", "statistics.json"}
        with np.load(folder / "motion.npz") as file:
            assert len(file["translations"]) == FRAMES
        rows = json.loads((folder / "statistics.json").read_text())["frames"]
        late = [True, True, False, False, False] if number == 2 else [False] * FRAMES
        assert [row["verdict"] == "lost" for row in rows] == late
        if number == 2:
            assert rows[0]["reasons"] == "this person has not been in the scene yet"
    with pytest.warns(UserWarning, match="2 of 5 frames are lost"):
        motion = load_motion(finished / "person_2" / "motion.npz")
    apart = np.asarray(motion.poses.translations[:, 0] - truth.poses.translations[:, 0])
    np.testing.assert_allclose(apart[2:], np.tile([DISTANCE, 0, 0], (FRAMES - 2, 1)), atol=0.03)
    # before it comes in, the pose is the first one
    np.testing.assert_array_equal(motion.poses.translations[0], motion.poses.translations[2])


def test_a_stopped_run_continues_to_the_same_result(inputs, finished, tmp_path, capsys, monkeypatch):
    append, left = Journal.append, [3]

    def stopping(self, record):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        append(self, record)

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "append", stopping)
        with pytest.raises(SystemExit) as stop:
            runs(capsys, *command(inputs, out, "--people", "2"))
    assert stop.value.code == 130
    assert "--overwrite" in fails(capsys, *command(inputs, out, "--people", "2"))
    runs(capsys, *command(inputs, out, "--people", "2", "--resume"))
    for number in (1, 2):
        with (
            np.load(out / f"person_{number}" / "motion.npz") as first,
            np.load(finished / f"person_{number}" / "motion.npz") as second,
        ):
            assert set(first.files) == set(second.files)
            assert all(np.array_equal(first[name], second[name]) for name in first.files)
    # replaced by a run of one body, the folders of people are gone
    runs(capsys, *command(inputs, out, "--overwrite", "--last", 0))
    assert not list(out.glob("person_*"))


def test_each_person_is_tracked_with_the_own_shape(inputs, tmp_path, capsys, monkeypatch):
    out, given = tmp_path / "out", []

    def estimate(tracker, clouds, num_people, model):
        given.append((len(clouds), num_people))
        return [
            eqx.tree_at(lambda b: b.vertices, tracker.body, size * tracker.body.vertices)
            for size in (1.001, 0.999)
        ]

    monkeypatch.setattr(person_shape, "estimate_people_shapes", estimate)
    auto = ("--people", "auto", "--fit-shape")
    runs(capsys, *command(inputs, out, *auto))
    assert given == [(FRAMES, None)]
    vertices = [load_body(str(out / f"person_{k}" / "person.npz"))[0].vertices for k in (1, 2)]
    np.testing.assert_allclose(vertices[0] / 1.001, vertices[1] / 0.999, atol=1e-6)
    with np.load(out / "person_1" / "motion.npz") as file:
        assert len(file["translations"]) == FRAMES
    # a run whose frames are gone estimates no shape again
    for path in (out / "journal", *out.glob("person_*/[ms]*")):
        path.unlink()
    runs(capsys, *command(inputs, out, *auto, "--resume"))
    assert len(given) == 1
    assert (out / "person_2" / "motion.npz").exists()


def test_one_body_in_clouds_of_two_people_is_reported(inputs, tmp_path, capsys, monkeypatch):
    # a search would find the same, after a long compilation
    monkeypatch.setattr(advance, "needs_search", lambda frame: False)
    capsys.readouterr()
    main([str(word) for word in command(inputs, tmp_path / "out", "--last", 2)])
    assert "1 of 3 frames show something else of a person's size" in capsys.readouterr().err


def test_wrong_numbers_are_refused(inputs, tmp_path, capsys):
    for people in ("0", "two", "-1"):
        line = fails(capsys, *command(inputs, tmp_path / "out", f"--people={people}"))
        assert "at least 1, or auto" in line


def test_the_points_of_a_frame_are_those_of_their_person():
    body = human(resolution="low", joints="tracking")
    trackers = [make_tracker(body)] * 2
    template = people_template(trackers, 0)
    rest, people, points = rest_pose(body.skeleton), [], []
    for number, absent in enumerate(template):
        pose = shift_roots(body.skeleton, rest, np.array([number * DISTANCE, 0.0, 0.0]))
        tracked = dataclasses.replace(absent.tracked, state=start_state(trackers[0], pose, 0.01), pose=pose)
        people.append(dataclasses.replace(absent, tracked=tracked, seen=True, present=True))
        points.append(np.asarray(body.vertices) + [number * DISTANCE, 0.0, 0.0])
    cloud = make_cloud(np.concatenate(points), np.tile(np.asarray(pose_body(body, rest).normals), (2, 1)))
    rows = np.stack([pack(tuple(people), 0.0)])
    own = divide_clouds(trackers, template, rows, LazyFrames(["both"], lambda frame: cloud))
    there = np.asarray(cloud.weights) > 0
    right = np.asarray(cloud.points)[:, 0] > DISTANCE / 2
    for number in range(2):
        weights = np.asarray(own(number, 0).weights)
        assert weights[there & (right == number)].mean() > 0.95
        assert weights[there & (right != number)].mean() < 0.01
