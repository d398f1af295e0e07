"""The pages beyond what they run: tables of papers, lists of the reference, and the site that is made of them."""

import ast
import importlib.util
import os
import re
import subprocess
import sys

import pytest

from scripts.docs_site import FUNCTION, NAMES, public_names
from tests.docs_pages import CHECKOUT

DOCS = CHECKOUT / "docs"
PAPERS = sorted((DOCS / "papers").glob("*.md"))
#: of papers with numbers: their text, how a number of an equation looks in it, and how many there are
NUMBERED = {
    "kineben": ("kineben-em-tracking.txt", r"\(([1-9]\d?)\)\.?\s*$", 42),
    "limits": ("implicit-surface-joint-limits.txt", r"\\quad \((\d)\)", 4),
    "adaptation": ("model-adaptation-thesis.txt", r"\(([234A]\.\d{1,2})\)\s*$", 53),
}


def rows_of(page) -> list[list[str]]:
    """The cells of all rows of a page's tables, without heads and rules."""
    lines = [line for line in page.read_text("utf-8").splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    return [row for row in rows if row[0] not in ("equation", "step", "section", "in the paper")]


@pytest.mark.parametrize("page", PAPERS, ids=lambda page: page.stem)
def test_every_row_of_a_paper_names_functions_that_are_there(page):
    rows = rows_of(page)
    assert len(rows) > 10
    for row in rows:
        *_, functions, remark = row
        if functions == "not used":
            assert remark, f"{row[0]} is not used; say why"
            continue
        found = FUNCTION.findall(functions)
        assert found, f"{row[0]} has no function"
        for name, module in found:
            tree = ast.parse((CHECKOUT / f"{module}.py").read_text("utf-8"))
            names = {node.name for node in tree.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
            assert name in names, f"{row[0]}: {module}.py has no {name}"


@pytest.mark.shared
@pytest.mark.parametrize("name", NUMBERED)
def test_every_equation_of_a_paper_is_in_its_table(name, shared):
    text, pattern, count = NUMBERED[name]
    printed = set(re.findall(pattern, (shared / "papers" / text).read_text("utf-8"), re.MULTILINE))
    listed = [row[0].strip("()") for row in rows_of(DOCS / "papers" / f"{name}.md") if row[0].startswith("(")]
    assert len(printed) == count
    assert printed <= set(listed), f"not in the table: {sorted(printed - set(listed))}"
    assert len(listed) == len(set(listed))


def test_files_by_topic_exist():
    """A name without a folder is in the folder of the file before it."""
    text = (
        (CHECKOUT / "CONTRIBUTING.md")
        .read_text("utf-8")
        .partition("## Files by topic")[2]
        .partition("\n## ")[0]
    )
    rows = [line.split("|")[2] for line in text.splitlines() if line.startswith("| ") and "`" in line]
    assert len(rows) > 20
    for row in rows:
        folder = CHECKOUT / "jaxcap"
        for name in re.findall(r"`([^`]+)`", row):
            path = CHECKOUT / "jaxcap" / name if "/" in name else folder / name
            assert path.exists(), f"CONTRIBUTING.md names {path}"
            folder = path.parent


def test_every_public_name_has_one_page_of_the_reference():
    wings = [
        wing.strip()
        for page in (DOCS / "reference").glob("*.md")
        for names in NAMES.findall(page.read_text("utf-8"))
        for wing in names.split(",")
    ]
    assert len(wings) == len(set(wings))
    assert set(public_names().values()) == set(wings)


def test_every_page_is_in_the_navigation():
    listed = re.findall(r"([\w/]+\.md)$", (CHECKOUT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")}
    notebooks = {f"notebooks/{path.stem}.md" for path in (CHECKOUT / "notebooks").glob("*.py")}
    assert len(listed) == len(set(listed))
    assert set(listed) == pages | notebooks | {"reference/papers.md"}


def test_links_between_pages_lead_somewhere():
    for page in [CHECKOUT / "README.md", *DOCS.rglob("*.md"), *(CHECKOUT / "notebooks").rglob("*.md")]:
        for link in re.findall(r"\]\(((?!https?:)[^)#\s]+)", page.read_text("utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    if not (importlib.util.find_spec("mkdocs") and importlib.util.find_spec("mkdocstrings")):
        pytest.skip('needs pip install -e ".[docs]"')
    words = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(tmp_path / "site"),
    ]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(words, cwd=CHECKOUT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / "site" / "papers" / "kineben" / "index.html").read_text("utf-8")
    # a function of a table leads to its reference
    assert re.search(r'href="[^"]*reference/[^"]*#jaxcap\.fit\.solvers\.gauss_newton\.damped_step"', page)
