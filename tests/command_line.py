"""Running the command line in this process, and small inputs for it."""

import sys
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.cli import main
from jaxcap.cli.console import heartbeat
from jaxcap.cli.console.groups import JAXCAP
from jaxcap.cli.console.verbs import Verb, VerbGroup
from jaxcap.geometry.camera import ring_of_cameras
from jaxcap.io.archives.npz import save_body, save_motion
from jaxcap.scanner.scan import scan_frame
from jaxcap.scanner.settings import Scanner

FRAMES, POINTS = 5, 600
# words in a silence depend on how busy the machine is; `test_cli_start` has them by its own clock
heartbeat.SILENCE_SECONDS = float("inf")
_pose_body = eqx.filter_jit(pose_body)


def verb_named(words: Sequence[str]) -> type:
    """Find the class of a verb by its words, such as "edit", "cut"."""
    found: VerbGroup | Verb = JAXCAP
    for word in words:
        assert isinstance(found, VerbGroup)
        found = found.verbs[word]
    assert isinstance(found, Verb)
    return found.load()


def fails(capsys, *arguments, code: int = 2) -> str:
    """The one line on stderr with which a command ends; it must be one, and no traceback."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in arguments])
    assert stop.value.code == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("jaxcap: ")
    assert "Traceback" not in lines[0]
    return lines[0]


def runs(capsys, *arguments) -> str:
    """What a command that goes well writes on stdout."""
    capsys.readouterr()
    main([str(word) for word in arguments])
    return capsys.readouterr().out


def write_inputs(folder: Path) -> Path:
    """`body.npz`, a small human, `clouds.npz` of its first steps, and their `truth.npz`."""
    body = human(joints="tracking", resolution="low")
    motion = walk_and_wave(body.skeleton, seconds=FRAMES / 30)
    scanner, cameras = Scanner(noise=0.004, points=POINTS), ring_of_cameras(6, 360, 2.5, 0.5, [0.0, 0.0, 0.0])
    scans = []
    for frame in range(FRAMES):
        vertices = np.asarray(_pose_body(body, motion[frame]).vertices, float)
        scans.append(scan_frame(scanner, cameras, vertices, np.asarray(body.faces), frame=frame))
    points, normals = [scan.points for scan in scans], [scan.normals for scan in scans]
    save_body(folder / "body.npz", body)
    np.savez(folder / "clouds.npz", points=np.stack(points), normals=np.stack(normals))
    save_motion(folder / "truth.npz", motion, body.skeleton)
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    """All files under a folder with their content."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


PYTHON = sys.executable
