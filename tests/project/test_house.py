"""The house: folders of one idea, files of one idea, and a line of what is in each."""

import ast
import statistics
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
FILES = sorted((CHECKOUT / "jaxcap").rglob("*.py"))
#: files of a folder, lines of a file, and lines of the median file, at most
MOST_FILES, MOST_LINES, MEDIAN = 15, 400, 120


@pytest.mark.parametrize("room", ["jaxcap", "tests"])
def test_a_folder_holds_one_idea(room):
    folders = {file.parent for file in (CHECKOUT / room).rglob("*.py")}
    counts = {str(folder.relative_to(CHECKOUT)): len(list(folder.glob("*.py"))) for folder in folders}
    assert {name: count for name, count in counts.items() if count > MOST_FILES} == {}


def test_a_file_holds_one_idea():
    lines = {str(file.relative_to(CHECKOUT)): len(file.read_text("utf-8").splitlines()) for file in FILES}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}
    assert statistics.median(lines.values()) <= MEDIAN


def test_every_file_and_room_says_what_is_in_it():
    silent = [str(file) for file in FILES if ast.get_docstring(ast.parse(file.read_text("utf-8"))) is None]
    assert silent == []
