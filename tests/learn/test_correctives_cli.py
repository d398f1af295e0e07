"""`jaxcap learn --correctives`: what is written, printed and reported, and what is refused."""

import json
import re

import numpy as np
import pytest
from command_line import fails, runs

from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion
from jaxcap.body.skin import CorrectedSkin
from jaxcap.cli import main
from jaxcap.cli.learn import learn as verb
from jaxcap.io.archives.npz import load_body, load_motion
from jaxcap.learn.correctives import learn_correctives
from jaxcap.learn.learn_body import Learned
from tests.learn.test_correctives import COUNT, take
from tests.learn.test_correctives import truth as truth


@pytest.fixture
def meshes(truth, tmp_path, monkeypatch):
    """Meshes with correctives in a file, and learning that finds everything but these at once."""
    body, corrected, poses = truth

    def learn_body(meshes, **options):
        rows = [frame for frame in range(COUNT + 4) if frame % 4 != 3 or len(meshes) < 20][: len(meshes)]
        motion = Motion(take(poses, np.array(rows)))
        return Learned(body, motion, np.zeros((0, 2), int), (("start", 1.0),), np.zeros(0))

    monkeypatch.setattr(verb, "learn_body", learn_body)
    # the tubes are open, and have no inside
    monkeypatch.setattr(verb, "check_meshes", lambda *meshes: [])
    vertices = np.asarray(posed_vertices(corrected, take(poses, slice(COUNT + 4))))
    path = tmp_path / "meshes.npz"
    np.savez(path, vertices=vertices, faces=np.asarray(body.faces))
    np.savez(tmp_path / "few.npz", vertices=vertices[:6], faces=np.asarray(body.faces))
    return path


def test_correctives_are_written_printed_and_reported(truth, meshes, tmp_path, capsys):
    _, corrected, poses = truth
    out, folder = tmp_path / "body.npz", tmp_path / "report"
    options = ("--skeleton", "none", "--hold-out", "4", "--report", folder)
    printed = runs(capsys, "learn", meshes, "-o", out, "--correctives", *options)
    stated = re.search(
        r"correctives: rank (\d+) at 6 joints, (\d+) in all; the surface moves by at most", printed
    )
    assert stated, printed
    rank, units = map(int, stated.groups())
    assert "poses that are left out of the fit: vertex RMSE" in printed
    rows = {line.split(",")[0]: line.split()[-3:] for line in printed.splitlines() if "meshes  " in line}
    assert list(rows) == [
        "training without correctives",
        "held out without correctives",
        "training",
        "held out",
    ]
    assert float(rows["held out"][2]) < 0.3 * float(rows["held out without correctives"][2])
    body, motion = load_body(out), load_motion(tmp_path / "body-motion.npz")
    assert body.skin.layer.shape[0] == units and not body.skin.rectified
    # everything that poses a body uses them
    gaps = np.asarray(posed_vertices(body, motion.poses)) - np.asarray(
        posed_vertices(corrected, take(poses, np.arange(COUNT + 4)[np.arange(COUNT + 4) % 4 != 3]))
    )
    assert np.sqrt(np.mean(np.sum(gaps**2, 2))) < 0.002
    report = json.loads((folder / "report.json").read_text())["correctives"]
    assert report["used"] and report["rank"] == rank >= 2
    assert [row["joint"] for row in report["joints"]] == ["spine", "chest", "elbow", "hand", "neck", "jaw"]
    assert sum(row["rank"] for row in report["joints"]) == units
    assert report["left_out_vertex_rmse"]["with"] < 0.3 * report["left_out_vertex_rmse"]["without"]
    assert (folder / "correctives.png").read_bytes()[:4] == b"\x89PNG"


def test_too_few_meshes_and_bones_without_parents_are_refused(meshes, tmp_path, capsys):
    out = tmp_path / "body.npz"
    said = fails(capsys, "learn", tmp_path / "few.npz", "-o", out, "--skeleton", "none", "--correctives")
    assert "--correctives needs at least 8 meshes besides those of --hold-out, and there are 6" in said
    said = fails(capsys, "learn", meshes, "-o", out, "--free-bones", "--correctives")
    assert "--correctives depend on joints, and --free-bones has none" in said


def test_a_body_whose_meshes_hardly_bend_is_written_without_correctives(
    meshes, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(learn_correctives, "MIN_ROTATION", 180.0)
    out = tmp_path / "body.npz"
    capsys.readouterr()
    options = ("--skeleton", "none", "--correctives", "--hold-out", "4")
    main(["learn", str(meshes), "-o", str(out), *options])
    printed = capsys.readouterr().err
    assert "--correctives: no joint rotates by more than" in printed and "The body has none." in printed
    assert not isinstance(load_body(out).skin, CorrectedSkin)
