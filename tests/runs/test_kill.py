"""Runs that are killed at random moments and resumed end in the same bits, and leave nothing half-written."""

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from adapt_scene import make_scene, write_folder
from command_line import PYTHON, write_inputs
from markers_scene import puppet

import jaxcap as jc
from jaxcap.io.archives.archive import load_arrays

pytestmark = pytest.mark.slow

PROGRAM = [PYTHON, "-c", "import sys; from jaxcap.cli import main; main(sys.argv[1:])"]
#: how often a run is killed
KILLS = 3


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Starts a verb in a process; all of them share what is compiled, so that most of their time is work."""
    cache = tmp_path_factory.mktemp("compiled")
    named = {"JAX_COMPILATION_CACHE_DIR": str(cache), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}

    def begin(*words) -> subprocess.Popen:
        return subprocess.Popen(
            [*PROGRAM, *map(str, words)],
            env={**os.environ, **named},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    return begin


def ends(running: subprocess.Popen) -> None:
    _, told = running.communicate(timeout=1800)
    assert running.returncode == 0, told[-2000:]


def content(folder: Path) -> dict[str, object]:
    """What is in the files of a folder and below, arrays by name; without what says how long something took, without files
    that go on, and without those that have no name yet."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        temporary = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_dir() or temporary or path.name in ("journal", "statistics.csv", "statistics.json"):
            continue
        if path.suffix == ".npz":
            # a file that is half written raises
            found |= {f"{name}:{key}": values.tobytes() for key, values in load_arrays(path).items()}
        elif path.suffix != ".partial":
            found[name] = path.read_bytes()
    return found


def killed_and_resumed(start, words, out: Path, seed: int) -> None:
    """Kill and resume the run that `words(folder)` begin, in folders in `out`, as `seed` has it."""
    rng, whole, cut = np.random.default_rng(seed), out / "whole", out / "cut"
    # once to compile, and once to know how long it takes
    for folder in (out / "first", whole):
        folder.mkdir()
        begun = time.monotonic()
        ends(start(*words(folder)))
        taken = time.monotonic() - begun
    expected = content(whole)
    assert expected == content(out / "first")
    cut.mkdir()
    for number in range(KILLS):
        running = start(*words(cut), *(["--resume"] if number else []))
        time.sleep(rng.uniform(0.2, 1.0) * taken)
        if running.poll() is not None:
            break
        running.send_signal(signal.SIGKILL)
        running.communicate(timeout=60)
        # what has its name is whole
        assert content(cut).items() <= expected.items()
    else:
        running = start(*words(cut), "--resume")
    ends(running)
    assert content(cut) == expected


def test_track(start, tmp_path):
    inputs = write_inputs(tmp_path)
    command = ["track", inputs / "body.npz", inputs / "clouds.npz", "-o"]
    (tmp_path / "runs").mkdir()
    killed_and_resumed(start, lambda folder: [*command, folder / "out"], tmp_path / "runs", seed=1)


def test_learn(start, tmp_path):
    from jaxcap.body.body import posed_vertices
    from tests.cli.test_cli_learn import FRAMES, bar, poses

    body = bar()
    meshes = np.asarray(posed_vertices(body, poses()))
    meshes = meshes + 0.001 * np.random.default_rng(0).normal(size=meshes.shape)
    np.savez(tmp_path / "meshes.npz", vertices=meshes[:FRAMES], faces=np.asarray(body.faces))
    command = ["learn", tmp_path / "meshes.npz", "--joints", 1, "--rounds", 3, "-o"]
    (tmp_path / "runs").mkdir()
    killed_and_resumed(start, lambda folder: [*command, folder / "body.npz"], tmp_path / "runs", seed=2)


def test_adapt(start, tmp_path):
    scene = make_scene()
    folder = write_folder(tmp_path, scene)
    jc.save_motion(folder / "start.npz", jc.stack_poses(scene[2][:1]), scene[0].skeleton)
    command = ["adapt", folder / "body.npz", *sorted(folder.glob("*.ply")), "--start", folder / "start.npz"]
    command += ["--frames", 3, "--smoothness", 0, "-o"]
    (tmp_path / "runs").mkdir()
    killed_and_resumed(start, lambda out: [*command, out / "a.npz"], tmp_path / "runs", seed=3)


def test_markers_solve(start, tmp_path):
    scene = puppet(np.random.default_rng(5), frames=480, noise=2e-4)
    labels = [f"{name}{n}" for name in ("trunk", "rarm", "rhand", "larm", "lhand", "head") for n in range(4)]
    trials = []
    for number in range(3):
        trials.append(tmp_path / f"trial{number}.c3d")
        places = scene.places[160 * number : 160 * (number + 1)]
        jc.write_markers(trials[-1], jc.make_markers(places, labels, 100.0))
    ends(start("markers", "fit", trials[0], "-o", tmp_path / "subject.npz", "--local"))
    command = ["markers", "solve", tmp_path / "subject.npz", *trials, "--joints", "joints.trc"]
    (tmp_path / "runs").mkdir()
    killed_and_resumed(start, lambda out: [*command, "-o", out / "out"], tmp_path / "runs", seed=4)
