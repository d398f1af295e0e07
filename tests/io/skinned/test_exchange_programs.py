"""Our files in other programs: Khronos's validator, Blender, three.js and OpenUSD. Each part runs where its program is
there: OpenUSD with the extra `usd`, the others where `python -m benchmarks.exchange` has installed them, in
`~/.cache/jaxcap/programs` or the folder that JAXCAP_PROGRAMS names."""

import os
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import jaxcap as jc
from benchmarks.files._exchange import Case, chain, make_truth
from benchmarks.files._programs.run import in_blender, validate
from benchmarks.files.exchange import (
    check_blender,
    check_three,
    check_usd,
    check_validator,
    compare,
    prepare_case,
)
from benchmarks.report import missed_limits
from benchmarks.view._browser import find_chromium
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.skin import swing_twist_from

PROGRAMS = Path(os.environ.get("JAXCAP_PROGRAMS") or Path.home() / ".cache" / "jaxcap" / "programs")
pytestmark = pytest.mark.slow


def program(name: str) -> Path:
    """Where an installed program is; the test is skipped where it is not there."""
    if not (PROGRAMS / name / "complete").exists():
        pytest.skip(f"{name} is not in {PROGRAMS}; python -m benchmarks.exchange installs it")
    return PROGRAMS / name


@pytest.fixture(scope="module", params=["chain", "growing", "human"])
def work(request, tmp_path_factory):
    if request.param == "human":
        body = jc.human(resolution="low")
        body = eqx.tree_at(lambda b: b.skin, body, swing_twist_from(body.skin, body.skeleton))
        case = Case("human", body, walk_and_wave(body.skeleton, seconds=0.5))
    elif request.param == "chain":
        case = Case("chain", *chain(12))
    else:
        case = Case("growing", *chain(12, grows=True, rate=29.97))
    return prepare_case(tmp_path_factory.mktemp(request.param), case, 0.001, 4)


def holds(parts) -> None:
    """That every figure is there and within its limit."""
    for name, figures, limits in parts:
        assert missed_limits(figures, limits) == [], (name, figures)


def test_khronos_validator(work):
    holds(check_validator(program("node"), work))


def test_khronos_validator_of_odd_files(tmp_path):
    """At rest, of one frame, without faces, more than four bones a vertex; and one that is wrong, so that wrong is told."""
    home = program("node")
    body, motion = chain(3)
    for name, given, moves in (
        ("rest", body, None),
        ("frame", body, motion.slice(slice(1, 2))),
        ("cloud", eqx.tree_at(lambda b: b.faces, body, body.faces[:0]), motion),
        ("many", body, motion),
    ):
        jc.write_gltf(tmp_path / f"{name}.glb", given, moves)
    found = validate(home, sorted(tmp_path.iterdir()))
    assert {name: (told["errors"], told["warnings"]) for name, told in found.items()} == {
        f"{name}.glb": (0, 0) for name in ("cloud", "frame", "many", "rest")
    }
    whole = (tmp_path / "many.glb").read_bytes()
    assert b'"JOINTS_1"' in whole
    (tmp_path / "wrong.glb").write_bytes(whole.replace(b'"JOINTS_1"', b'"JOINTS_7"'))
    assert validate(home, [tmp_path / "wrong.glb"])["wrong.glb"]["errors"] > 0


def test_three(work):
    home = program("node")
    pytest.importorskip("playwright")
    if find_chromium() is None:
        pytest.skip("there is no Chromium")
    holds(check_three(home, work, None))


def test_openusd(work):
    pytest.importorskip("pxr")
    holds(check_usd(work))


def test_blender(work):
    holds(check_blender(program("blender") / "bin" / "python", work))


def test_another_frame_is_another_pose(tmp_path):
    """So the comparisons above can fail."""
    python = program("blender") / "bin" / "python"
    case = Case("chain", *chain(12))
    made = prepare_case(tmp_path, case, 0.001, 2)
    found = in_blender(python, made.written.glb, case.motion.rate, [0, 1])
    truth = make_truth(made.written.linear.body, made.written.motion, [0, 2])
    figures = compare(found, truth, list(truth.names))
    assert min(figures.values()) > 1
    assert np.isfinite(list(figures.values())).all()
