"""Advice after a tracking run: another size, another vertical, and cameras for clouds that hide parts."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import write_inputs
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.cli.sources import Clouds, load_body, up_rotation
from jaxcap.cli.track import advice
from jaxcap.cli.track.frame_records import Results
from jaxcap.cli.track.results import warn_of_results
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.observe import missing_cloud
from jaxcap.tracking.track_frame import make_tracker


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return write_inputs(tmp_path_factory.mktemp("inputs"))


def test_a_person_of_another_size_is_told_if_the_first_frame_is_not_good(inputs, capsys, monkeypatch):
    sought = []
    monkeypatch.setattr(advice, "search_size", lambda *_: sought.append(1) or 0.8)
    monkeypatch.setattr(advice, "warn_of_other_vertical", lambda *_: False)
    body, clouds = load_body(str(inputs / "body.npz"))[0], read_clouds(inputs / "clouds.npz")
    # the first frame shows nobody, so the second one counts
    frames = Clouds(clouds, body).with_loaded(0, missing_cloud("nobody", ()))
    rest = jc.rest_pose(body.skeleton)

    def advise(verdict, fits_shape=False):
        count = len(frames)
        verdicts = [("lost", ()), (verdict, ()), *[("good", ())] * (count - 2)]
        poses = jc.stack_poses([rest] * count, 30.0).poses
        results = Results(np.zeros(count), poses, None, verdicts, [()] * count, [False] * count)
        advice.advise(make_tracker(body), frames, (), results, "y", fits_shape=fits_shape)
        return capsys.readouterr().err

    with monkeypatch.context() as patch:
        # without the joints of a person, the shape cannot be fitted
        patch.setattr(advice, "human_prior", lambda _: None)
        assert "size" not in advise("doubtful")
    assert "size" not in advise("good") + advise("doubtful", fits_shape=True) and not sought
    told = advise("doubtful")
    assert "about 0.8 times the size of the body" in told and "--fit-shape" in told
    monkeypatch.setattr(advice, "search_size", lambda *_: 1.0)
    told = advise("lost")
    assert "times the size" not in told and "most frames are lost" not in told
    monkeypatch.setattr(advice, "MANY_LOST", 0.1)
    assert "explains the first one; check the unit and the body" in advise("lost")


def test_a_person_who_lies_is_asked_for_the_vertical(inputs, capsys):
    """A turn of the trunk by 90 degrees in two of three frames, in data with z up."""
    skeleton = load_body(str(inputs / "body.npz"))[0].skeleton
    rest = jc.rest_pose(skeleton)
    half = np.sqrt(0.5)
    turned = eqx.tree_at(
        lambda p: p.rotations, rest, rest.rotations.at[0].set(jnp.array([half, half, 0.0, 0.0]))
    )
    results = Results(
        np.zeros(3),
        jc.stack_poses([rest, turned, turned], 30.0).poses,
        None,
        [("good", ())] * 3,
        [()] * 3,
        [False] * 3,
    )
    assert advice.warn_of_vertical(results, "y")
    assert "in 67% of the frames that are not lost the trunk points along z of the data" in (
        told := capsys.readouterr().err
    )
    assert "give --up=z" in told
    # y of these poses is z of the data
    assert advice.warn_of_vertical(results, "z") and "give --up=-y" in capsys.readouterr().err
    lost = results._replace(verdicts=[("lost", ()), ("good", ()), ("lost", ())])
    assert not advice.warn_of_vertical(lost, "y")
    upright = results._replace(verdicts=[("good", ()), ("good", ()), ("lost", ())])
    assert not advice.warn_of_vertical(upright, "y") and not capsys.readouterr().err


def test_another_vertical_is_named_if_a_person_is_much_likelier_with_it(inputs, capsys, monkeypatch):
    """The stand-in for a search prefers clouds that are long along y, and finds the person upright."""
    body, clouds = load_body(str(inputs / "body.npz"))[0], read_clouds(inputs / "clouds.npz")
    found = jc.rest_pose(body.skeleton)
    monkeypatch.setattr(
        advice, "initialise", lambda _, cloud: (found, np.ptp(np.asarray(cloud.points), axis=0)[1])
    )
    tracker = make_tracker(body)
    longest = "xyz"[np.argmax(np.ptp(np.asarray(Clouds(clouds, body)[0].points), axis=0))]
    for up in "xyz":
        warned = advice.warn_of_other_vertical(tracker, Clouds(clouds, body, up)[0], up)
        printed = capsys.readouterr().err
        named = f"give --up={longest}" in printed or f"give --up=-{longest}" in printed
        assert warned == named == (up != longest)
    # the pose that the search finds with another vertical stands along the given one
    other = next(up for up in "xyz" if up != longest)
    turn = Rotation.from_matrix(up_rotation(longest) @ up_rotation(other).T)
    found = eqx.tree_at(
        lambda p: p.rotations, found, found.rotations.at[0].set(turn.as_quat(scalar_first=True))
    )
    assert not advice.warn_of_other_vertical(tracker, Clouds(clouds, body, other)[0], other)


def test_clouds_that_hide_parts_are_asked_for_cameras(capsys):
    hidden = Results(np.zeros(1), None, None, [("good", ())], [("LeftHand",)], [False])
    for of_clouds in (True, False):
        warn_of_results(hidden, of_clouds=of_clouds)
        assert ("give the images with --depth and --cameras" in capsys.readouterr().err) == of_clouds
    warn_of_results(hidden._replace(unseen=[()]), of_clouds=True)
    assert not capsys.readouterr().err
