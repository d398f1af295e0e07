"""No verb is silent for ten seconds, by a clock beside it, with nothing compiled before."""

import os
import selectors
import subprocess
import time

import numpy as np
import pytest
from adapt_scene import make_scene, write_folder
from command_line import PYTHON, write_inputs
from markers_scene import puppet

import jaxcap as jc

pytestmark = pytest.mark.slow

PROGRAM = [PYTHON, "-c", "import sys; from jaxcap.cli import main; main(sys.argv[1:])"]
#: seconds without a word
LONGEST = 10.0


def silences(tmp_path, *words) -> list[float]:
    """The seconds between the words of a verb, on stdout and stderr alike, from its start to its end."""
    environment = {**os.environ, "JAXCAP_CACHE": str(tmp_path / "compiled"), "PYTHONUNBUFFERED": "1"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    times, told = [time.monotonic()], b""
    with subprocess.Popen(
        [*PROGRAM, *map(str, words)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as running:
        assert running.stdout is not None
        with selectors.DefaultSelector() as waiting:
            waiting.register(running.stdout, selectors.EVENT_READ)
            while waiting.select(timeout=600):
                some = os.read(running.stdout.fileno(), 1 << 16)
                times.append(time.monotonic())
                told += some
                if not some:
                    break
        assert running.wait(60) == 0, told[-2000:]
    assert b"slow_operation_alarm" not in told and b"XLA_FLAGS" not in told
    return np.diff(times).tolist()


def test_track_that_searches(tmp_path):
    inputs = write_inputs(tmp_path)
    words = [
        "track",
        inputs / "body.npz",
        inputs / "clouds.npz",
        "--initialise",
        "always",
        "--last",
        1,
        "-o",
        tmp_path / "out",
    ]
    found = silences(tmp_path, *words)
    assert max(found) < LONGEST and sum(found) > LONGEST


def test_learn(tmp_path):
    from jaxcap.body.body import posed_vertices
    from tests.cli.test_cli_learn import bar, poses

    body = bar()
    np.savez(tmp_path / "meshes.npz", vertices=posed_vertices(body, poses()), faces=np.asarray(body.faces))
    words = ["learn", tmp_path / "meshes.npz", "--joints", 1, "--rounds", 2, "-o", tmp_path / "body.npz"]
    assert max(silences(tmp_path, *words, "--report", tmp_path / "report")) < LONGEST


def test_adapt(tmp_path):
    folder = write_folder(tmp_path, make_scene())
    words = ["adapt", folder / "body.npz", folder / "*.ply", "--frames", 3, "-o", folder / "a.npz"]
    assert max(silences(tmp_path, *words)) < LONGEST


def test_markers_fit_and_solve(tmp_path):
    scene = puppet(np.random.default_rng(5), frames=320, noise=2e-4)
    labels = [f"{name}{n}" for name in ("trunk", "rarm", "rhand", "larm", "lhand", "head") for n in range(4)]
    jc.write_markers(tmp_path / "rom.c3d", jc.make_markers(scene.places, labels, 100.0))
    subject = tmp_path / "subject.npz"
    fit = ["markers", "fit", tmp_path / "rom.c3d", "-o", subject, "--report", tmp_path / "report"]
    assert max(silences(tmp_path, *fit)) < LONGEST
    solve = ["markers", "solve", subject, tmp_path / "rom.c3d", "-o", tmp_path / "out"]
    assert max(silences(tmp_path, *solve)) < LONGEST
