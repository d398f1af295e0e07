"""Run headless Chromium with software rendering, and query the page of a viser window."""

import contextlib
import shutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
#: WebGL without a graphics card: SwiftShader comes with the browser, `gl-egl` is what the machine has (Mesa)
ANGLES = {
    "swiftshader": ("--enable-unsafe-swiftshader", "--use-angle=swiftshader"),
    "gl-egl": ("--ignore-gpu-blocklist", "--use-gl=angle", "--use-angle=gl-egl"),
}
#: the page around the scene is painted without GL, which in software would take longer than the scene
BROWSER_OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu-rasterization")
#: of a node of the scene, where it has come
GEOMETRY = """name => {
    const node = window.__viserMutable.nodeRefFromName[name];
    let found = null;
    if (node) node.traverse(o => { if (o.geometry && o.geometry.attributes.position && found === null)
        found = o.geometry.attributes.position.array; });
    return found;
}"""
RENDERER = """() => {
    const gl = document.createElement('canvas').getContext('webgl2');
    if (gl === null) return null;
    return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL);
}"""


def find_chromium() -> str | None:
    """Find the path of a browser, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextlib.contextmanager
def launch_browser(angle: str = "swiftshader") -> Iterator:
    """Launch a browser by Playwright for the duration of the context. Raises `RuntimeError` if none is installed."""
    from playwright.sync_api import sync_playwright

    program = find_chromium()
    if program is None:
        raise RuntimeError(f"No browser was found; expected one of {', '.join(BROWSERS)}; install one.")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=[*BROWSER_OPTIONS, *ANGLES[angle]])
        try:
            yield browser
        finally:
            browser.close()


def open_page(browser, url: str, size: tuple[int, int], timeout: float = 60.0):
    """Open a page and wait for its connection; `timeout` is the timeout of all waits, seconds."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(1000 * timeout)
    page.goto(url)
    page.wait_for_function("window.__viserMutable !== undefined")
    return page


def wait_for_node(page, name: str) -> None:
    """Wait until a node of the scene has a geometry in the page."""
    page.wait_for_function(f"({GEOMETRY})('{name}') !== null")


def wait_for_camera(page, camera: Any, target: ArrayLike) -> None:
    """Wait until the browser reports by `client.camera` that it looks at `target`.

    Earlier values are those that the window requested, or those of a new page.
    """
    asked, end = time.time(), time.monotonic() + 60.0
    while camera.update_timestamp < asked or np.abs(np.array(camera.look_at) - target).max() > 1e-3:
        if time.monotonic() > end:
            raise TimeoutError("The browser did not report the new camera position.")
        page.evaluate("window.__viserMutable.sendCamera()")
        page.wait_for_timeout(50)


def project_to_page(camera: Any, position: ArrayLike) -> Float[np.ndarray, "2"]:
    """Project a position in the scene to pixels of a page, by the camera that the browser reports (`client.camera`)."""
    eye, width, height = np.array(camera.position), camera.image_width, camera.image_height
    ahead = np.array(camera.look_at) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, camera.up_direction)
    right /= np.linalg.norm(right)
    away = np.asarray(position) - eye
    x, y = (float(away @ axis) for axis in (right, np.cross(right, ahead)))
    share = float(away @ ahead) * np.tan(camera.fov / 2)
    return np.array([(width + height * x / share) / 2, height * (1 - y / share) / 2])
