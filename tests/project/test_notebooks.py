"""Notebooks run, and their executed files have the cells of the current text."""

import json
import os
import re
import subprocess
import sys

import pytest

from tests.docs_pages import CHECKOUT

NAMES = (
    "adapt",
    "batch",
    "body_model",
    "depth",
    "energy",
    "gradients",
    "learn",
    "limits",
    "markers",
    "terms",
    "track",
)
QUICK = ("gradients", "markers")
#: a cell's head in the percent format: a remark in brackets says that it is text
HEAD = re.compile(r"^# %%(?: \[(markdown)\])?\n", re.MULTILINE)
#: what has to be printed
TOLD = {
    "batch": "every solution comes nearer as the weight grows: True",
    "energy": "of 72 directions a hand alone leaves 69 free",
    "limits": "of the frames are beyond",
    "markers": "240 frames solved, 0 lost",
    "terms": "every fit is higher with the term: True",
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
    assert sorted(path.stem for path in (CHECKOUT / "notebooks").glob("*.ipynb")) == list(NAMES)


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
def test_a_notebook_has_the_cells_of_its_text_and_their_outputs(name):
    """`python scripts/render_notebooks.py NAME` makes it anew."""
    folder = CHECKOUT / "notebooks"
    notebook = json.loads((folder / f"{name}.ipynb").read_text("utf-8"))
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]
    assert cells == cells_of((folder / f"{name}.py").read_text("utf-8")), f"render {name} anew"
    assert notebook["metadata"]["jupytext"]["formats"] == "ipynb,py:percent"
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in code)
    assert not any(output["output_type"] == "error" for cell in code for output in cell["outputs"])


def test_outputs_of_notebooks_have_pictures_and_are_small():
    pages = sorted((CHECKOUT / "notebooks").glob("*.ipynb"))
    pictures = sum(page.read_text("utf-8").count('"image/png"') for page in pages)
    assert pictures > 12
    assert sum(page.stat().st_size for page in pages) < 3_000_000
