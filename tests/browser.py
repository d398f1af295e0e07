"""A real browser for tests of windows: Chromium without a screen, drawing in software, driven by Playwright.

A test module says `from browser import chromium` and its tests ask for `chromium`: `page = chromium(url)`.
"""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from benchmarks.view._browser import GEOMETRY, find_chromium, launch_browser, open_page
from benchmarks.view._browser import wait_for_node as wait_for_node

#: small, as every pixel is drawn by the processor; the controls take a third of it
SIZE = (960, 480)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Callable]:
    """`chromium(url)` opens a page and waits until it is connected; all pages close with the module."""
    pytest.importorskip("playwright.sync_api", reason="needs Playwright")
    if find_chromium() is None:
        pytest.skip("needs Chromium")
    with launch_browser() as browser:
        yield lambda url: open_page(browser, url, SIZE)


def vertices(page, name: str) -> np.ndarray:
    """The vertices of a mesh or of points of the scene, as three.js has them in the page, (V, 3)."""
    return np.array(page.evaluate(f"name => Array.from(({GEOMETRY})(name))", name)).reshape(-1, 3)


def wait_for_vertex(page, name: str, number: int, place, within: float = 1e-4) -> None:
    """Until a vertex has come to a place, metres."""
    page.wait_for_function(
        f"""([name, number, place, within]) => {{
            const there = ({GEOMETRY})(name);
            return there !== null && place.every((x, i) => Math.abs(there[3 * number + i] - x) < within);
        }}""",
        arg=[name, number, [float(x) for x in place], within],
    )


def shown(page, name: str) -> bool:
    """Whether a node is in the page and neither it nor one above it is hidden."""
    return page.evaluate(
        """name => {
            let node = window.__viserMutable.nodeRefFromName[name];
            if (!node) return false;
            for (; node; node = node.parent) if (!node.visible) return false;
            return true;
        }""",
        name,
    )
