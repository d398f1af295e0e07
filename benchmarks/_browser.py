"""Run headless Chromium with software rendering, and query the page of a viser window."""

import contextlib
import shutil
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
#: WebGL without a graphics card: SwiftShader comes with the browser, `gl-egl` is what the machine has (Mesa)
ANGLES = {
    "swiftshader": ("--enable-unsafe-swiftshader", "--use-angle=swiftshader"),
    "gl-egl": ("--ignore-gpu-blocklist", "--use-gl=angle", "--use-angle=gl-egl"),
}
#: the page around the scene is painted without GL, which in software would take longer than the scene
PLAIN = ("--headless=new", "--no-sandbox", "--disable-gpu-rasterization")
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
    """The path of a browser, if there is one."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


@contextlib.contextmanager
def launched(angle: str = "swiftshader") -> Iterator:
    """Playwright's browser, as long as the context lasts. Raises `RuntimeError` where there is none."""
    from playwright.sync_api import sync_playwright

    program = find_chromium()
    if program is None:
        raise RuntimeError(f"No browser was found; expected one of {', '.join(PROGRAMS)}; install one.")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=[*PLAIN, *ANGLES[angle]])
        try:
            yield browser
        finally:
            browser.close()


def open_page(browser, url: str, size: tuple[int, int], patience: float = 60.0):
    """A page of a window, once it is connected; `patience` is in seconds, for this and all that is waited for."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(1000 * patience)
    page.goto(url)
    page.wait_for_function("window.__viserMutable !== undefined")
    return page


def wait_for_node(page, name: str) -> None:
    """Until a node of the scene has a geometry in the page."""
    page.wait_for_function(f"({GEOMETRY})('{name}') !== null")


def wait_for_eye(page, camera: Any, middle: ArrayLike) -> None:
    """Until the browser tells by `client.camera` that it looks at `middle`, where its window has turned it. What is there
    before is what the window asked for, or where a page looks that has just come."""
    asked, end = time.time(), time.monotonic() + 60.0
    while camera.update_timestamp < asked or np.abs(np.array(camera.look_at) - middle).max() > 1e-3:
        if time.monotonic() > end:
            raise TimeoutError("The browser did not report the new camera position.")
        page.evaluate("window.__viserMutable.sendCamera()")
        page.wait_for_timeout(50)


def pixel(camera: Any, place: ArrayLike) -> Float[np.ndarray, "2"]:
    """Where a place in the scene is on a page, pixels, by the camera that a browser tells (`client.camera`)."""
    eye, width, height = np.array(camera.position), camera.image_width, camera.image_height
    ahead = np.array(camera.look_at) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, camera.up_direction)
    right /= np.linalg.norm(right)
    away = np.asarray(place) - eye
    x, y = (float(away @ axis) for axis in (right, np.cross(right, ahead)))
    share = float(away @ ahead) * np.tan(camera.fov / 2)
    return np.array([(width + height * x / share) / 2, height * (1 - y / share) / 2])
