"""What pages show is what happens: their Python runs, and their commands are the command line's."""

import numpy as np
import pytest
import tyro

from jaxcap.cli import main
from tests.docs_pages import CHECKOUT, GIVEN, all_pages, commands_of, python_of

#: sections of this page need other libraries: tests/project/test_interoperability.py
OTHERS = "docs/interoperability.md"
WITH_PYTHON = [page for page in all_pages() if page != OTHERS and python_of(page)]
#: pages whose Python takes seconds
LIGHT = ("docs/conventions.md", "CONTRIBUTING.md")
#: verbs that take a moment where their files are there
CHEAP = ("info", "convert")


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=() if page in LIGHT else pytest.mark.slow) for page in WITH_PYTHON]
)
def test_python_of_a_page_runs(page, tmp_path, monkeypatch):
    """Block by block in one namespace, in an empty folder; then what commands on the page it has made files for."""
    names = GIVEN.get(page, lambda folder: {})(tmp_path)
    monkeypatch.chdir(tmp_path)
    for block in python_of(page):
        exec(compile("\n" * block.before + block.text, str(CHECKOUT / page), "exec"), names)
    CLAIMS.get(page, lambda names: None)(names)
    for words in commands_of(page):
        # what has been written by the page's Python is not written again
        files = [tmp_path / word for word in words[1:3] if "." in word]
        if words[0] in CHEAP and files and files[0].is_file() and not any(f.exists() for f in files[1:]):
            main(words)


def readme_claims(names):
    assert names["motion"].num_frames == 3
    assert float(names["solution"].energies["VertexLandmarks"]) < 0.1 * 20 * 3 * 0.05**2


def tracking_claims(names):
    """Frames are found, from a start that is off and after a stop."""
    assert names["motion"].num_frames == 4
    assert not any(tracked.lost for tracked in names["frames"])
    off = np.abs(
        np.asarray(
            names["motion"].poses.translations - names["performance"].slice(slice(0, 4)).poses.translations
        )
    )
    assert off.max() < 0.02
    for statistic in (names["statistics"].sigma, names["statistics"].mean_distance):
        assert float(statistic.max()) < 0.03


def energies_claims(names):
    body, posed = names["body"], names["jc"].pose_body
    held = posed(body, names["ordered"].pose).vertices[names["heels"]]
    np.testing.assert_allclose(held, body.vertices[names["heels"]], atol=2e-3)
    # a foot goes up about as far as its heel is pulled
    assert 0.2 < float(names["slope"][:, 1].sum()) < 1.5
    assert bool(names["alone"].unobservable.any())
    assert not bool(names["found"].unobservable.any())


#: what has to be true after a page has run, beyond its own assertions
CLAIMS = {
    "README.md": readme_claims,
    "docs/tracking.md": tracking_claims,
    "docs/energies.md": energies_claims,
}


@pytest.mark.parametrize("page", [page for page in all_pages() if commands_of(page)])
def test_commands_of_a_page_are_those_of_the_command_line(page, monkeypatch, capsys):
    """Every verb and option exists and takes such a value; nothing is run."""
    parsed, real = [], tyro.cli

    def parse(*arguments, **options):
        command = real(*arguments, **options)
        parsed.append(type(command).__name__.lower())
        monkeypatch.setattr(type(command), "run", lambda _: None)
        return command

    monkeypatch.setattr(tyro, "cli", parse)
    for words in commands_of(page):
        try:
            main(words)
        except SystemExit as stop:
            said = capsys.readouterr()
            if stop.code:
                pytest.fail(f"{page}: jaxcap {' '.join(words)}\n{said.out}{said.err}")
        else:
            assert words == ["--version"] or parsed[-1] in words


def test_pages_were_found():
    assert {"README.md", "docs/tracking.md", "docs/energies.md", "docs/limits.md"} <= set(WITH_PYTHON)
    assert sum(len(commands_of(page)) for page in all_pages()) > 30
