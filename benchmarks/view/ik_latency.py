"""Measure the latency of inverse kinematics while a point is dragged: `python -m benchmarks.ik_latency`.

The embedded human with 13,380 vertices and ten constraints, nine of them held and one dragged around a loop, half of
which is out of reach; float32. A solve is timed from the new target to the posed surface that is there in NumPy. Then a
window in Chromium: real moves of a mouse on a ball, from the page's own mouse event to the change of the surface's buffer
in the page, both by the page's clock; without a browser on the machine that part is left out. A frame that is drawn by
the processor and not by a graphics card waits for the one before it, which is part of what is measured. Run it with
nothing else beside.
"""

import argparse
import time

import numpy as np

from benchmarks.report import finish, progress
from benchmarks.view._browser import (
    find_chromium,
    launch_browser,
    open_page,
    project_to_page,
    wait_for_camera,
    wait_for_node,
)
from jaxcap.body.body import Body
from jaxcap.body.people.human import human
from jaxcap.edit.ik import session as ik
from jaxcap.edit.ik.session import IkSession, IkSettings
from jaxcap.view.ik.window import posed_arrays, serve_ik
from jaxcap.view.windows.serve import address, close_server, open_server

JOINTS = ("LeftHand", "RightHand", "LeftFoot", "RightFoot", "Head", "Spine1", "LeftForeArm", "RightForeArm",
          "LeftLeg", "RightLeg")  # fmt: skip
SURFACE, SIZE = "/body/surface", (960, 640)


def ten_constraints(body: Body, solver: str) -> tuple[IkSession, int]:
    """Start a session with ten constrained vertices near joints; the first one is dragged."""
    places, centres = np.asarray(body.vertices), np.asarray(body.skeleton.centres)
    session = ik.begin_session(body, settings=IkSettings(solver))  # pyright: ignore[reportArgumentType]
    held = []
    for name in JOINTS:
        apart = np.linalg.norm(places - centres[body.skeleton.index(name)], axis=1)
        held.append(int(np.argmin(apart)))
        session = ik.add_constraint(session, held[-1])
    return session, held[0]


def target_loop(centre: tuple[float, float, float], count: int) -> list[tuple[float, float, float]]:
    """Make targets on a loop around a hand; half of the loop is out of reach."""
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    around = np.stack([np.cos(turns) - 1, np.sin(turns), 0.3 * np.sin(2 * turns)], 1)
    return [(float(x), float(y), float(z)) for x, y, z in np.asarray(centre) + 0.25 * around]


def solve_milliseconds(body: Body, solver: str, count: int) -> list[float]:
    session, hand = ten_constraints(body, solver)
    targets = target_loop(ik.find_constraint(session, hand).target, count)
    session, taken = ik.begin_drag(session), []
    for target in targets[:3] + targets:
        start = time.perf_counter()
        session = ik.drag(session, hand, target)
        np.asarray(posed_arrays(session.body, session.state.pose)[0])
        taken.append(1000 * (time.perf_counter() - start))
    return taken[3:]


#: keeps, in the page, the time of every mouse move and of every change of the surface's vertices
WATCH = """surface => {
    window.moves = []; window.changes = [];
    addEventListener('pointermove', () => window.moves.push(performance.now()), true);
    let last = null, version = -1;
    const look = () => {
        const node = window.__viserMutable.nodeRefFromName[surface];
        if (node) node.traverse(o => {
            const p = o.geometry && o.geometry.attributes.position;
            if (p && (p !== last || p.version !== version)) {
                if (last !== null) window.changes.push(performance.now());
                last = p; version = p.version;
            }
        });
        setTimeout(look, 1);
    };
    look();
}"""


def browser_milliseconds(body: Body, moves: int, rest: float) -> list[float]:
    """Measure the time from a mouse move to the next change of the surface, with pauses between moves."""
    session, hand = ten_constraints(body, "levenberg-marquardt")
    server = open_server(0)
    windows = serve_ik(server, session)
    taken: list[float] = []
    with launch_browser() as browser:
        page = open_page(browser, address(server), SIZE, 300.0)
        wait_for_node(page, SURFACE)
        while not windows or windows[0].note:
            time.sleep(0.1)
        window = windows[0]
        wait_for_camera(page, window.client.camera, window.middle)
        at = project_to_page(window.client.camera, ik.find_constraint(window.session, hand).target)
        page.mouse.move(*at)
        page.mouse.down()
        page.mouse.move(at[0] + 6, at[1] - 6)
        page.mouse.move(at[0] + 8, at[1] - 8)
        time.sleep(2.0)
        page.evaluate(WATCH, SURFACE)
        for number in range(moves):
            turn = 2 * np.pi * number / moves
            page.evaluate("() => { window.moves = []; window.changes = []; }")
            page.mouse.move(at[0] + 20 * np.cos(turn), at[1] - 30 + 20 * np.sin(turn))
            time.sleep(rest)
            moved, changed = page.evaluate("[window.moves, window.changes]")
            later = [change for change in changed if moved and change > moved[0]]
            if later:
                taken.append(later[0] - moved[0])
        page.mouse.up()
    close_server(server)
    return taken


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ik_latency", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument(
        "--rest", type=float, default=0.5, help="seconds between two mouse moves in the browser"
    )
    parser.add_argument("--no-browser", action="store_true")
    options = parser.parse_args()
    body = human()
    figures, seconds = {}, {}
    for solver, name in (
        ("levenberg-marquardt", "solve"),
        ("gauss-newton", "gauss_newton"),
        ("priorities", "priorities"),
    ):
        start = time.perf_counter()
        taken = solve_milliseconds(body, solver, options.frames if name == "solve" else options.frames // 4)
        seconds[name] = time.perf_counter() - start
        figures |= {
            f"{name}_median_ms": float(np.median(taken)),
            f"{name}_p99_ms": float(np.percentile(taken, 99)),
        }
        progress(
            f"{solver}: median {np.median(taken):.1f} ms, 99th percentile {np.percentile(taken, 99):.1f} ms"
        )
    if not options.no_browser and find_chromium() is not None:
        shown = browser_milliseconds(body, options.moves, options.rest)
        figures |= {
            "browser_median_ms": float(np.median(shown)),
            "browser_p90_ms": float(np.percentile(shown, 90)),
            "browser_share_answered": len(shown) / options.moves,
        }
        progress(
            f"in the browser: median {np.median(shown):.0f} ms, of {len(shown)} of {options.moves} moves"
        )
    sizes = {
        "vertices": len(body.vertices), "constraints": len(JOINTS), "frames": options.frames, "moves": options.moves,
    }  # fmt: skip
    finish("ik_latency", figures, {"solve_median_ms": ("<=", 30.0)}, sizes, seconds)


if __name__ == "__main__":
    main()
