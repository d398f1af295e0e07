"""Runs of `jaxcap adapt` that were stopped or have ended: they go on to the same bits, tell of themselves, and are told
from other runs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, write_folder, write_scan
from command_line import fails, runs, tree

import jaxcap as jc
from jaxcap.adapt.objective import Terms
from jaxcap.adapt.task import AdaptSettings, AdaptState, plan_stages
from jaxcap.body.kinematics import joint_paths
from jaxcap.body.people.sample import sample_poses
from jaxcap.body.pose import stack_poses
from jaxcap.cli.adapt import adapt as adapt_module
from jaxcap.cli.adapt.actor import load_finished_run, save_actor
from jaxcap.cli.adapt.adapt import Adapt
from jaxcap.cli.adapt.input import check_input
from jaxcap.cli.adapt.state import fingerprint_of, keep_state, load_resumed_state
from jaxcap.io.archives.journal import hash_file
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.registry import write_motion

#: stages and frames of the next one that are kept when Ctrl-C comes, and words for it: within tracking, and, gone on
#: with, when the first round of vertices is left
STOPS = ((1, 2), "1 stage is"), ((3, 0), "3 stages are")


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture
def folder(scene, tmp_path):
    write_folder(tmp_path, scene)
    jc.save_motion(tmp_path / "start.npz", stack_poses(scene[2][:1], 30.0), scene[0].skeleton)
    return tmp_path


def words(folder, out, *more) -> tuple:
    """As a shell makes them of `scans/*.ply`, which need not be in the order of frames."""
    scans = sorted(folder.glob("*.ply"), reverse=True)
    return ("adapt", folder / "body.npz", *scans, "-o", out, "--start", folder / "start.npz", *more)


def finished_state(scene, **changes) -> AdaptState:
    _, actor, poses, _ = scene
    state = AdaptState(
        done=len(plan_stages(AdaptSettings(temporal_weight=0.0))),
        body=actor,
        size=1.1,
        motion=stack_poses(poses, 30.0),
        lost=(2,),
        chosen=(0, 3),
        history=(("size", 4.0), ("pose", 1 / 3)),
        coefficients=(0.1, -2 / 3),
        pose_weight=1e-7 / 3,
        terms=(Terms(1.6e-5, 2.0, 1e-5, 0.0, 0.0), Terms(1e-6, 3.0, 1 / 3, 4e-6, 1e-8)),
    )
    return state._replace(**changes)


def begun(folder, scene, state: AdaptState | None) -> Adapt:
    """A run that is asked for by `words(folder, folder / "a.npz", "--smoothness", 0)` and has reached a state."""
    scans = tuple(str(path) for path in folder.glob("*.ply"))
    run = Adapt(str(folder / "body.npz"), scans, folder / "a.npz", start=folder / "start.npz", smoothness=0.0)
    if state is not None:
        keep_state(run.checkpoint_path, state, header_of(run, scene))
    return run


def header_of(run: Adapt, scene) -> dict[str, object]:
    digests = check_input(read_clouds(run.clouds), scene[0]).digests
    return {**run.settings(), "prior": None, **fingerprint_of(scene[0], digests)}


def same_leaves(one, other) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b) and np.asarray(a).dtype == np.asarray(b).dtype for a, b in pairs)


def test_the_file_of_an_actor_tells_of_its_run_to_the_last_bit(scene, tmp_path):
    path, motion, header = tmp_path / "a.npz", tmp_path / "m.npz", {"rate": 30.0, "scans": 6}
    state = finished_state(scene)
    jc.save_motion(motion, state.motion, state.body.skeleton)
    save_actor(path, state, {"angles": np.arange(3.0)}, header, motion)
    again = load_finished_run(path, motion, header)
    assert same_leaves(again, state)
    assert (again.history, again.terms, again.lost) == (state.history, state.terms, state.lost)
    assert same_leaves(jc.load_body(path), state.body)
    with pytest.raises(jc.InputError, match=r"a\.npz: this run was started with rate 30.0, not 25.0"):
        load_finished_run(path, motion, {**header, "rate": 25.0})
    other = state.motion.slice(slice(1, None))
    jc.save_motion(motion, other, state.body.skeleton)
    with pytest.raises(jc.InputError, match=r"m\.npz: this is not the motion that was written with .*a\.npz"):
        load_finished_run(path, motion, header)
    jc.save_body(path, state.body)
    with pytest.raises(jc.InputError, match=r"a\.npz: this file does not record the run that made the body"):
        load_finished_run(path, motion, header)


def test_a_motion_that_was_written_as_bvh_is_read_again(scene, tmp_path):
    """In a report it counts by where it takes the joints."""
    body = jc.human(resolution="low", joints="tracking")
    motion = jc.Motion(sample_poses(body.skeleton, 6), 30.0)
    write_motion(tmp_path / "m.bvh", body.skeleton, motion)
    save_actor(
        tmp_path / "a.npz", finished_state(scene, body=body, motion=motion), {}, {}, tmp_path / "m.bvh"
    )
    again = load_finished_run(tmp_path / "a.npz", tmp_path / "m.bvh", {}).motion
    here, there = (joint_paths(body.skeleton, one.poses) for one in (again, motion))
    np.testing.assert_allclose(here, there, atol=2e-5)
    assert again.rate == pytest.approx(30.0, rel=1e-6)


def test_a_run_that_has_ended(scene, folder, capsys):
    """It is not begun again, and its report is of these scans and settings alone."""
    state, out = finished_state(scene), folder / "a.npz"
    run = begun(folder, scene, None)
    jc.save_motion(run.motion_path, state.motion, state.body.skeleton)
    save_actor(out, state, {}, header_of(run, scene), run.motion_path)
    asked = words(folder, out, "--smoothness", 0, "--resume")
    before = tree(folder)
    assert "a.npz: this run is already complete" in runs(capsys, *asked)
    assert tree(folder) == before
    told = fails(capsys, *asked, "--report", folder / "a.html", "--rate", 25)
    assert "this run was started with rate 30.0, not 25.0" in told
    # one that was stopped before anything was kept begins
    assert load_resumed_state(run.checkpoint_path, {}, resume=True, overwrite=False) is None


@pytest.mark.parametrize("number", [0, 4])
def test_another_scan_is_another_run(scene, folder, capsys, number):
    begun(folder, scene, finished_state(scene))
    points, normals = (np.array(part) for part in scene[3][number])
    points[7] += 1e-4
    write_scan(folder, number, points, normals)
    told = fails(capsys, *words(folder, folder / "a.npz", "--smoothness", 0, "--resume"))
    assert f"this run was started with scan of frame {number} " in told
    write_scan(folder, number, points[:0], normals[:0])
    if number:
        told = fails(capsys, *words(folder, folder / "a.npz", "--smoothness", 0, "--resume"))
        assert f"scan of frame {number} " in told


def test_scans_of_other_normals_are_others(scene, folder):
    scans = read_clouds(sorted(folder.glob("*.ply")))
    digests = check_input(scans, scene[0]).digests
    assert check_input(scans, scene[0]).digests == digests
    points, normals = scene[3][2]
    write_scan(folder, 2, points, -normals)
    changed = check_input(scans, scene[0]).digests
    assert [n for n, (one, other) in enumerate(zip(digests, changed, strict=True)) if one != other] == [2]


def test_another_start_or_template_is_another_run(scene, folder, capsys):
    run = begun(folder, scene, finished_state(scene))
    asked = words(folder, folder / "a.npz", "--smoothness", 0, "--resume")
    jc.save_motion(folder / "start.npz", stack_poses(scene[2][1:2], 30.0), scene[0].skeleton)
    assert "this run was started with start " in fails(capsys, *asked)
    header = header_of(run, scene)
    body = jc.load_body(folder / "body.npz")
    assert fingerprint_of(body, ())["template"] == header["template"]
    skin = jc.body.RigidSkin(jnp.zeros(len(body.vertices), int))
    other = jc.Body(body.skeleton, skin, body.vertices, body.faces)
    assert fingerprint_of(other, ())["template"] != header["template"]


def test_what_is_given_is_told_in_a_few_words():
    assert adapt_module.clouds_words(("scans/*.ply",)) == "scans/*.ply"
    many = tuple(f"scans/{n}.ply" for n in range(300))
    assert adapt_module.clouds_words(many) == "scans/0.ply ... scans/299.ply (300 files)"


def stopped_after(at):
    """A `keep_state` that Ctrl-C meets once it has kept so many stages, and frames of the next one."""
    kept = []

    def keep(path, state, header):
        if kept[-1:] == [at]:
            raise KeyboardInterrupt
        keep_state(path, state, header)
        kept.append((state.done, state.within))

    return keep


@pytest.mark.slow
def test_a_run_that_is_stopped_goes_on_to_the_same_bits(folder, capsys, monkeypatch):
    """And its report, made with it, is the one that is made afterwards."""
    monkeypatch.setattr(
        adapt_module, "AdaptSettings", partial(AdaptSettings, proportion_rounds=1, rounds=(1, 1))
    )
    whole, parts = folder / "whole.npz", folder / "parts.npz"
    report = ("--report-every", 3, "--frames", 3, "--report")
    runs(capsys, *words(folder, whole, *report, folder / "with.html"))
    before = whole.read_bytes()

    monkeypatch.setattr(adapt_module, "MIN_CHECKPOINT_FRAMES", 2)
    more: tuple = ()
    for at, done in STOPS:
        with monkeypatch.context() as patch:
            patch.setattr(adapt_module, "keep_state", stopped_after(at))
            with pytest.raises(SystemExit) as stop:
                runs(capsys, *words(folder, parts, "--frames", 3, *more))
        assert stop.value.code == 130
        told, more = capsys.readouterr().err, ("--resume",)
        assert f"stopped; {done} saved in {parts}.partial; --resume continues" in told
        assert not parts.exists()
    quoted = ("adapt", folder / "body.npz", folder / "*.ply", "-o", parts, "--start", folder / "start.npz")
    runs(capsys, *quoted, "--frames", 3, "--resume")
    assert not (folder / "parts.npz.partial").exists()
    for name in ("{}.npz", "{}-motion.npz"):
        with np.load(folder / name.format("whole")) as one, np.load(folder / name.format("parts")) as other:
            # files carry the time at which they were written
            compared = set(one.files) - {"run.motion"}
            assert compared == set(other.files) - {"run.motion"}
            assert all(np.array_equal(one[array], other[array]) for array in compared)

    runs(capsys, *words(folder, whole, "--resume", *report, folder / "after.html"))
    assert (folder / "after.html").read_text() == (folder / "with.html").read_text()
    assert whole.read_bytes() == before
    assert hash_file(folder / "whole-motion.npz") == str(np.load(whole)["run.motion"])
