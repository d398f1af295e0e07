"""The help of every verb in groups, and the folder of the demo."""

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from command_line import verb_named

from jaxcap.cli.console.console import ordinal
from jaxcap.cli.console.help import BASICS, INPUT, KINEBEN, OUTPUT, TITLES, verb_help
from jaxcap.cli.demo import Demo
from jaxcap.errors import InputError

VERBS = (
    "demo", "rig", "learn", "fit", "adapt", "track", "live", "scan", "evaluate", "batch", "view", "ik", "info", "convert", "markers info",
    "markers fit", "markers solve", "limits learn", "limits check", "limits project", "limits compare", "prior learn",
    "prior info", "edit retarget", "edit gaze", "edit glue", "edit cut", "edit join", "edit loop", "edit resample", "edit mirror",
    "edit keys",
)  # fmt: skip


def groups_of(text: str) -> dict[str, list[str]]:
    """Titles with the first words of their entries, in their order."""
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        if re.fullmatch(r"[A-Z][\w ]*:", line):
            found[line[:-1]] = []
        elif found and re.match(r"  \S", line):
            found[list(found)[-1]].append(line.strip())
    return found


@pytest.mark.parametrize("words", VERBS)
def test_options_stand_once_in_their_groups(words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    verb = verb_named(words.split())
    text = verb_help(verb, f"jaxcap {words}")
    groups = groups_of(text)
    order = [BASICS, INPUT, TITLES.get(words, "Settings"), OUTPUT, KINEBEN]
    assert list(groups) == [title for title in order if title in groups]
    assert next(iter(groups)) == BASICS
    assert text.startswith(f"usage: jaxcap {words} ")
    assert all(len(line) <= 100 for line in text.splitlines() if "{" not in line)
    # every field once: in capitals where it has no default and no dashes
    entries = [entry for group in groups.values() for entry in group]
    names = [name for entry in entries for name in re.findall(r"^(?:-\w \w+, )?--([\w-]+)", entry)]
    assert len(set(names)) == len(names)
    positional = [entry for entry in entries if not entry.startswith("-")]
    fields = dataclasses.fields(verb)
    assert len(positional) + len(names) + ("-h, --help" in text) == len(fields) + 1
    assert groups[BASICS][: len(positional)] == positional
    for name, title in (
        ("skl", KINEBEN),
        ("vj", KINEBEN),
        ("unit", INPUT),
        ("overwrite", BASICS),
    ):
        assert all(
            title == where
            for where, group in groups.items()
            if any(f"--{name}" == e.split()[0] for e in group)
        )


def test_track_has_its_basics_first(monkeypatch):
    """Of its options a newcomer needs the first."""
    groups = groups_of(verb_help(verb_named(("track",)), "jaxcap track"))
    assert [entry.split()[0] for entry in groups[BASICS]] == [
        "BODY",
        "CLOUDS...",
        "-o",
        "--resume",
        "--overwrite",
        "-h,",
    ]
    assert [entry.split()[0] for entry in groups[KINEBEN]] == ["--skl", "--vj"]
    assert "--sigma0" in " ".join(groups["Tracking"])


def test_narrow_and_wide(monkeypatch):
    """The same words at every width."""
    texts = []
    for columns in ("60", "90", "300"):
        monkeypatch.setenv("COLUMNS", columns)
        text = verb_help(verb_named(("adapt",)), "jaxcap adapt")
        texts.append(re.sub(r"\s+", " ", text.partition("Basics:")[2]))
    assert texts[0] == texts[1] == texts[2]


def test_git_ignores_a_folder_that_the_demo_makes(tmp_path):
    if shutil.which("git") is None:
        pytest.skip("needs git")
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    folder = tmp_path / "jaxcap-demo"
    Demo(out=folder).make_folder()
    Demo(out=folder).check_folder()
    (folder / "motion.bvh").write_text("")
    status = ["git", "-C", tmp_path, "status", "--porcelain", "--untracked-files=all"]
    assert subprocess.run(status, capture_output=True, text=True, check=True).stdout == ""
    with pytest.raises(
        InputError, match="give --overwrite to replace them, or choose another folder with -o"
    ):
        Demo(out=folder).check_folder()
    Demo(out=folder, overwrite=True).check_folder()
    assert not (folder / "motion.bvh").exists()
    # a folder that was there keeps what git says of it
    (tmp_path / "mine").mkdir()
    Demo(out=tmp_path / "mine").make_folder()
    assert list((tmp_path / "mine").iterdir()) == []


def test_the_demos_default_folder_is_ignored(checkout):
    assert f"{Demo().out}/" in (checkout / ".gitignore").read_text().split()
    assert Demo().out == Path("jaxcap-demo")


def test_numbers_have_their_endings():
    numbers = (1, 2, 3, 4, 11, 12, 13, 21, 52, 93, 100, 111)
    assert " ".join(map(ordinal, numbers)) == "1st 2nd 3rd 4th 11th 12th 13th 21st 52nd 93rd 100th 111th"
