"""The build of the package: folders and files of one idea, docstrings in plain words. `scripts/house.py` prints it."""

import statistics

import pytest

from scripts.house import (
    docstrings,
    files_of_folders,
    import_circles,
    lines_of_files,
    package_files,
    private_words,
    without_verb,
)

#: files of a folder, lines of a file, and lines of the median file, at most
MOST_FILES, MOST_LINES, MEDIAN = 15, 400, 120


@pytest.mark.parametrize("top", ["jaxcap", "tests", "benchmarks", "scripts"])
def test_a_folder_holds_one_idea(top):
    assert {name: count for name, count in files_of_folders(top).items() if count > MOST_FILES} == {}


def test_a_file_holds_one_idea():
    lines = lines_of_files()
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}
    assert statistics.median(lines.values()) <= MEDIAN


def test_every_file_has_a_docstring():
    assert len({place.partition(":")[0] for place, _, _ in docstrings()}) == len(package_files())


def test_docstrings_of_functions_begin_with_a_verb():
    verbless, functions = without_verb()
    assert functions > 2000
    assert len(verbless) <= 0.02 * functions, verbless


def test_no_file_imports_itself_through_others():
    assert import_circles() == []


def test_docstrings_and_help_have_no_private_words():
    assert private_words() == []
