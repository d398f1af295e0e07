"""The README's Python runs as it stands."""

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
