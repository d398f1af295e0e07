"""Notebooks run as they stand, and their rendered pages are of the current text."""

import os
import re
import subprocess
import sys

import pytest
from conftest import CHECKOUT

NAMES = ("adapt", "batch", "energy", "gradients", "learn", "limits", "markers", "track")
QUICK = ("gradients", "markers")
#: a cell's head in the percent format: a remark in brackets says that it is text
HEAD = re.compile(r"^# %%(?: \[(markdown)\])?\n", re.MULTILINE)
#: what has to be printed
TOLD = {
    "batch": "every solution comes nearer as the weight grows: True",
    "energy": "of 72 directions a hand alone leaves 69 free",
    "limits": "of the frames are beyond",
    "markers": "240 frames solved, 0 lost",
}


def cells_of(text: str) -> list[tuple[str, str]]:
    """Kind and source of each cell."""
    pieces = HEAD.split(text)[1:]
    cells = []
    for kind, source in zip(pieces[::2], pieces[1::2], strict=True):
        source = source.strip("\n")
        if kind:
            source = "\n".join(line.removeprefix("#").removeprefix(" ") for line in source.splitlines())
        cells.append((kind or "code", source))
    return cells


def test_all_notebooks_are_known():
    assert sorted(path.stem for path in (CHECKOUT / "notebooks").glob("*.py")) == list(NAMES)
    assert sorted(path.stem for path in (CHECKOUT / "notebooks/rendered").glob("*.md")) == list(NAMES)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in NAMES]
)
def test_a_notebook_runs(name):
    """In a process of its own, as some set JAX up otherwise than tests do."""
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(CHECKOUT), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, f"notebooks/{name}.py"],
        cwd=CHECKOUT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=1800,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert TOLD.get(name, "") in done.stdout
    if name == "gradients":
        apart = [float(x) for x in re.findall(r"against autodiff: (\S+)", done.stdout)]
        assert len(apart) == 2
        assert max(apart) < 1e-12
    if name == "batch":
        # rounding differs between programs, and may decide which of two vertices is nearest
        assert int(re.findall(r"agree to 1e-5: (\d+) of 16", done.stdout)[0]) >= 13
        alone, together = map(float, re.findall(r"joints: (\S+) mm alone, (\S+) mm together", done.stdout)[0])
        assert abs(alone - together) < 0.2


@pytest.mark.parametrize("name", NAMES)
def test_a_rendered_page_is_of_the_current_text(name):
    """Every cell stands in it, in order, and no other code; `python scripts/render_notebooks.py NAME` makes it anew."""
    folder = CHECKOUT / "notebooks"
    page, place = (folder / "rendered" / f"{name}.md").read_text("utf-8"), 0
    cells = cells_of((folder / f"{name}.py").read_text("utf-8"))
    for kind, source in cells:
        wanted = source.replace("](../", "](../../") if kind == "markdown" else f"```python\n{source}\n```"
        found = page.find(wanted, place)
        assert found >= 0, f"render {name} anew: this is not in its page\n{wanted}"
        place = found + len(wanted)
    assert page.count("```python\n") == sum(kind == "code" for kind, _ in cells)


def test_pictures_of_rendered_pages_are_there_and_small():
    folder = CHECKOUT / "notebooks" / "rendered"
    shown = {
        (page.parent / link).resolve()
        for page in folder.glob("*.md")
        for link in re.findall(r"!\[\]\(([^)]+)\)", page.read_text("utf-8"))
    }
    assert len(shown) > 12
    assert shown == {path.resolve() for path in folder.rglob("*.png")}
    assert sum(path.stat().st_size for path in shown) < 3_000_000
