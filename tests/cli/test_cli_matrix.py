"""Every verb given every kind of file: each ends well, or with one sentence that names the file and says what to do."""

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path

import pytest
import tyro
from command_line import verb_named
from file_kinds import ANIMATED, BODIES, BROKEN, FILE, FILES, FOREIGN, MARKERS, MESHES, MOTIONS, write_files
from file_places import PLACES

from jaxcap.cli import view
from jaxcap.cli.adapt import adapt
from jaxcap.cli.console.errors import report_errors
from jaxcap.cli.console.verbs import Verb
from jaxcap.cli.contents.depth import DepthOptions
from jaxcap.cli.contents.next_verb import COMMANDS, suggest_commands
from jaxcap.cli.info import Info
from jaxcap.errors import InputError
from jaxcap.io.skinned.clip import split_clip

#: of each sort a few, for every run
FEW = (
    "body.npz", "motion.npz", "walk.bvh", "human", "skinned.gltf", "doll.obj", "animated.glb:Walk", "animated.usda", "ball.obj", "ball.glb",
    "takes.c3d", "walk.fbx", "empty.npz", "notes", "what.foo", "nothing.npz", "limits.npz", "clouds.npz", "bones.skl",
    "cameras.json", "folder of markers",
)  # fmt: skip
#: what `info` refuses
UNKNOWN = (*FOREIGN, *BROKEN, "nothing.npz", "nothing.bvh", "empty folder")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    there = tmp_path_factory.mktemp("kinds")
    write_files(there)
    return there


@pytest.fixture
def inside(folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(adapt, "adapt_body", _adapt_nothing)
    before = set(folder.iterdir())
    yield folder
    for path in set(folder.iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def _adapt_nothing(*_, **__):
    """In place of minutes of adaptation to a file that is right."""
    raise InputError("This file is right; nothing is adapted to it here.")


def given(place, name: str):
    """The verb of a place, given a file."""
    verb, fields = Verb(place.verb, "").load(), {}
    for field, value in place.fields.items():
        put = tuple(name if one == FILE else one for one in value) if isinstance(value, tuple) else value
        put = name if put == FILE else put
        one_path = isinstance(put, str) and "pathlib" in str(verb.__annotations__[field])
        fields[field] = Path(put) if one_path else put
    return verb(**fields)


def outcome(run) -> tuple[int, str, str]:
    """Exit code, what was written on stdout, and on stderr."""
    said, wrong, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(wrong):
        try:
            with report_errors():
                run()
        except SystemExit as stop:
            code = stop.code
    return code, said.getvalue(), wrong.getvalue()


def check_sentence(wrong: str, where: str) -> str:
    """That the last line on stderr is a sentence that says what to do."""
    line = wrong.strip().splitlines()[-1]
    assert line.startswith("jaxcap: "), (where, line)
    assert line.endswith("."), (where, line)
    assert "; " in line or "`" in line, f"{where}: nothing to do in: {line}"
    assert "''" not in line, (where, line)
    return line


def check(place, name: str) -> None:
    where = f"{place.verb} {place.fields} {name}"
    code, _, wrong = outcome(given(place, name).run)
    assert code in (0, 2), (where, code, wrong)
    if name in place.right:
        # another file may be wrong, but this one is not of a wrong kind
        line = check_sentence(wrong, where) if code else ""
        assert not (f"jaxcap: {name}" in line and "; expected a" in line), (where, line)
        assert "there is no skin" not in line, (where, line)
        return
    assert code == 2, f"{where} was accepted"
    assert str(split_clip(name)[0]) in check_sentence(wrong, where), (where, wrong)


def titles(place) -> str:
    return (
        f"{place.verb}-{'-'.join(field for field, value in place.fields.items() if value in (FILE, (FILE,)))}"
    )


@pytest.mark.parametrize("place", PLACES, ids=titles)
def test_files_of_the_wrong_kind(inside, place):
    for name in dict.fromkeys((*FEW, *place.right[:2])):
        check(place, name)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES, ids=titles)
def test_all_files(inside, place):
    for name in FILES:
        check(place, name)


@pytest.mark.parametrize("name", FILES)
def test_info_knows_every_file(inside, name):
    """Which command comes next, or a sentence of what to do."""
    code, said, wrong = outcome(Info(name).run)
    if name in UNKNOWN:
        assert code == 2, said
        assert name in check_sentence(wrong, name)
        return
    assert code == 0, wrong
    first, *_, last = said.splitlines() if "\n" in said.strip() else [said, said]
    sorts = {
        "body:": BODIES, "motion:": (*MOTIONS, "run"), "markers:": MARKERS, "mesh:": MESHES[:5], "cloud:": ("cloud.ply",),
        "clouds:": ("clouds.npz", "folder of clouds"), "registered meshes:": ("meshes.npz", "folder of meshes"),
        "skeleton:": ("bones.skl", "02.asf"), "subject:": ("subject.npz",), "cameras:": ("cameras.json",),
        "constraints:": ("constraints.json",), "limits": ("limits.npz", "limits.cst"), "journal:": ("journal", "unfinished"),
        "statistics:": ("statistics.csv", "statistics.json"), "checkpoint:": ("run.partial",), "parts:": ("parts.vj",),
        "vertices:": ("marks.txt",), "pairs of words:": ("names.txt",), "scans of": ("scans",),
        "table of joints: 1 that match, 1 without": ("names.json",),
    }  # fmt: skip
    for start, names in sorts.items():
        if name in names:
            assert first.startswith(start), (name, said)
    unread = ("keys.npz", "report.json", "arrays.npz", "plot.png", "page.html")
    assert last.startswith("no verb reads" if name in unread else "next: `jaxcap "), (name, said)
    assert name in unread or "{" not in last


@pytest.mark.parametrize("kind", COMMANDS)
def test_the_next_command_can_be_typed(kind):
    """Every command that `info` names is understood as it stands, with nothing missing."""
    said = suggest_commands(kind, "a file", depth=DepthOptions(Path("a camera.json"), 500.0))
    commands = re.findall("`jaxcap (.*?)`", said)
    assert len(commands) == len(COMMANDS[kind])
    for line in commands:
        words = shlex.split(line)
        depth = 2 if words[0] in ("markers", "limits", "prior", "edit") else 1
        tyro.cli(verb_named(words[:depth]), args=words[depth:], config=(tyro.conf.FlagCreatePairsOff,))


@pytest.mark.parametrize("name", FILES)
def test_view_takes_what_has_a_shape(inside, monkeypatch, name):
    monkeypatch.setattr(view, "run_window", lambda *_: None)
    code, _, wrong = outcome(view.View((name,)).run)
    shapes = (
        *BODIES,
        *ANIMATED,
        *MOTIONS,
        *MESHES,
        *MARKERS,
        "meshes.npz",
        "clouds.npz",
        "subject.npz",
        "cameras.json",
    )
    if name in shapes:
        assert code == 0, wrong
    elif code == 2:
        assert str(split_clip(name)[0]) in wrong.strip().splitlines()[-1], (name, wrong)


def test_one_help_for_a_body():
    """What a body is stands in every help in the same words."""
    from jaxcap.cli.console.help import verb_help
    from jaxcap.cli.console.options import BODY_FORMATS

    taking = {place.verb for place in PLACES if place.fields.get("body", place.fields.get("target")) == FILE}
    for verb in sorted(taking - {"convert.convert.Convert"}):
        text = " ".join(verb_help(Verb(verb, "").load(), "jaxcap").split())
        assert BODY_FORMATS in text, verb
