"""The Python of the README and of the pages runs as it stands."""

import re

import pytest


@pytest.mark.slow
def test_snippets_run(checkout):
    snippets = re.findall(r"```python\n(.*?)```", (checkout / "README.md").read_text(), re.DOTALL)
    assert snippets
    names: dict = {}
    exec(compile("\n".join(snippets), "README.md", "exec"), names)
    assert names["motion"].num_frames == 3
    pulled = names["solution"].energies["VertexLandmarks"]
    assert float(pulled) < 0.1 * 20 * 3 * 0.05**2


@pytest.mark.slow
@pytest.mark.parametrize("page", ["limits"])
def test_snippets_of_pages_run(checkout, page):
    snippets = re.findall(r"```python\n(.*?)```", (checkout / "docs" / f"{page}.md").read_text(), re.DOTALL)
    assert snippets
    exec(compile("\n".join(snippets), f"{page}.md", "exec"), {})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["limits"])
def test_notebooks_run(checkout, name, capsys):
    source = (checkout / "notebooks" / f"{name}.py").read_text()
    exec(compile(source, f"{name}.py", "exec"), {"__name__": "__main__"})
    assert "of the frames are beyond" in capsys.readouterr().out
