"""Write assets/ik.png, Kineben's figure 5 in the browser: a body, points that are held, one that is dragged, the body after it.

`python -m scripts.ik_picture` opens the window of `jaxcap ik` in Chromium without a screen and works it with a mouse.
"""

import io
import time
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import jaxcap as jc
from benchmarks.view._browser import launch_browser, open_page, project_to_page, wait_for_node
from jaxcap.edit.ik import session as ik
from jaxcap.view.ik.window import IkWindow, serve_ik
from jaxcap.view.windows.serve import address, close_server, open_server

OUT = Path(__file__).resolve().parents[1] / "assets" / "ik.png"
SIZE = WIDTH, HEIGHT = 1080, 760
#: of a picture, where the body is; the controls stand beside it
LEFT, RIGHT = 300, 700
TITLES = ("(a) The body.", "(b) Constrained points; pinned ones in blue.", "(c) One point is dragged; the body follows.",
          "(d) The drag continues until release.")  # fmt: skip
PINNED = ("LeftToeBase", "RightToeBase", "LeftLeg", "RightLeg")


def main() -> None:
    body = jc.human()
    server = open_server(0)
    windows = serve_ik(server, ik.begin_session(body))
    with launch_browser() as browser:
        page = open_page(browser, address(server), SIZE, 300.0)
        wait_for_node(page, "/body/surface")
        while not windows or windows[0].note:
            time.sleep(0.1)
        window, pictures = windows[0], []
        pictures.append(picture(page))
        pin_vertices(page, window)
        pictures.append(picture(page))
        hand = window.session.state.constraints[-1]
        page.mouse.retract(*project_to_page(window.client.camera, hand.target))
        page.mouse.down()
        for target, title in (((-0.68, 0.62, 0.3), "c"), ((-0.3, 0.8, 0.3), "d")):
            drag_to(page, window, target, title)
            pictures.append(picture(page))
        page.mouse.up()
    close_server(server)
    write(pictures)


def pin_vertices(page, window: IkWindow) -> None:
    """Pin feet and knees by their vertices in front, and click a hand."""
    body = window.session.body
    places, centres = np.asarray(body.vertices), np.asarray(body.skeleton.centres)
    points = []
    for name in (*PINNED, "RightHand"):
        near = np.flatnonzero(np.linalg.norm(places - centres[body.skeleton.index(name)], axis=1) < 0.07)
        points.append(places[near[np.argmax(places[near, 2])]])
    for number, point in enumerate(points, 1):
        page.mouse.click(*project_to_page(window.client.camera, point))
        wait_until(lambda number=number: len(window.session.state.constraints) == number)
        if number <= len(PINNED):
            page.locator("input[type=checkbox]:visible").first.click()
            wait_until(lambda: window.session.state.constraints[-1].pinned)


def drag_to(page, window: IkWindow, target, title: str) -> None:
    """Move the mouse until the ball is at the pixel of a target."""
    ball = lambda: project_to_page(window.client.camera, window.session.state.constraints[-1].target)  # noqa: E731
    start, end = ball(), project_to_page(window.client.camera, target)
    for share in np.linspace(0, 1, 13)[1:]:
        page.mouse.retract(*(start + share * (end - start)))
        time.sleep(0.15)
    wait_until(lambda: np.linalg.norm(ball() - end) < 3)


def wait_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError("The window did not reach the expected state in time.")
        time.sleep(0.05)


def picture(page) -> Image.Image:
    time.sleep(3.0)
    whole = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return whole.crop((LEFT, 60, RIGHT, HEIGHT - 60))


def write(pictures: list[Image.Image]) -> None:
    width, height = pictures[0].size
    sheet = Image.new("RGB", (2 * width, 2 * (height + 30)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for number, (one, title) in enumerate(zip(pictures, TITLES, strict=True)):
        x, y = number % 2 * width, number // 2 * (height + 30)
        sheet.paste(one, (x, y))
        pen.text((x + width / 2, y + height + 14), title, "black", font, anchor="mm")
    sheet.save(OUT, optimize=True)
    print(f"{OUT}: {OUT.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
