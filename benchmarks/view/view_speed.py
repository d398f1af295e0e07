"""Time the viewer in a browser, and its installation and start: `python -m benchmarks.view_speed`.

`jaxcap view` plays a motion of the embedded human with 5,000 vertices, 60 frames per second, in Chromium without a screen. By
the page's own clock, a frame is an array of vertices that was not there at the browser's last drawing, so what came and was
never drawn is not counted. With a graphics card drawing costs nothing; here the processor draws, and the JSON line says by
what. Then the library is installed into a fresh virtual environment, and `jaxcap view human` started there: the clock runs
from `pip install` to the body in the browser, nothing compiled before. Run it with nothing else beside.

    python -m benchmarks.view_speed --angle swiftshader --no-install
"""

import argparse
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

import jaxcap as jc
from benchmarks.report import finish, progress
from benchmarks.view._browser import ANGLES, GEOMETRY, RENDERER, launch_browser, open_page, wait_for_node
from jaxcap.body.body import posed_vertices
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.io.archives.npz import save_body, save_motion

ROOT = Path(__file__).resolve().parents[2]
RATE, SURFACE = 60.0, "/0/body/surface"
#: arrays of vertices that are new at a drawing, and drawings, in so many seconds
COUNT_SCRIPT = f"""async ([names, seconds]) => {{
    const arrays = () => names.map(name => ({GEOMETRY})(name));
    let last = arrays(), frames = 0, drawings = 0, worst = 0;
    const start = performance.now();
    let before = start, now = start;
    while (now - start < 1000 * seconds) {{
        await new Promise(requestAnimationFrame);
        now = performance.now();
        drawings += 1;
        const here = arrays();
        if (here.some((array, i) => array !== last[i])) {{ frames += 1; worst = Math.max(worst, now - before); before = now; }}
        last = here;
    }}
    return [1000 * frames / (now - start), 1000 * drawings / (now - start), worst];
}}"""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.view_speed", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of frame counting, seconds")
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument(
        "--size", type=int, nargs=2, default=(800, 600), help="size of the browser window, pixels"
    )
    parser.add_argument(
        "--angle", choices=list(ANGLES), default="gl-egl", help="renderer without a graphics card"
    )
    parser.add_argument("--no-install", action="store_true")
    options = parser.parse_args()
    body = jc.human(resolution="medium")
    walk = walk_and_wave(body.skeleton, seconds=options.frames / 30.0)
    motion = jc.Motion(walk.poses, RATE)
    figures, seconds = {}, {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_scene(folder, body, motion)
        files = ("motion.npz", "--body", "body.npz", "--clouds", "clouds.npz")
        with launch_browser(options.angle) as browser, run_viewer(sys.executable, folder, *files) as url:
            page = open_page(browser, url, tuple(options.size), 120.0)
            renderer = page.evaluate(RENDERER)
            wait_for_node(page, SURFACE)
            # the scan is drawn only where it is asked for, as in the figure of the surface alone
            page.get_by_label("Scan").uncheck()
            page.get_by_role("button", name="Play").click()
            page.wait_for_timeout(3000)
            counted = page.evaluate(COUNT_SCRIPT, [[SURFACE], options.seconds])
            figures["frames_per_second"], figures["drawings_per_second"], figures["longest_gap_ms"] = counted
            progress(f"surface: {counted[0]:.1f} frames per second of {counted[1]:.1f} drawings")
            page.get_by_label("Colours").click()
            page.get_by_role("option", name="distance to the scan").click()
            # all distances once, so that what is counted is sending and drawing
            page.wait_for_timeout(1000 * (2 + 0.3 * options.frames))
            bands = [f"/0/body/colour{band}" for band in range(13)]
            counted = page.evaluate(COUNT_SCRIPT, [bands, options.seconds])
            figures["heat_map_frames_per_second"] = counted[0]
            progress(f"heat map: {counted[0]:.1f} frames per second of {counted[1]:.1f} drawings")
        if not options.no_install:
            seconds = measure_installation(folder, options.angle)
            figures["install_to_picture_seconds"] = seconds["picture"]
    sizes = {
        "vertices": len(body.vertices), "frames": options.frames, "window": list(options.size),
        "renderer": renderer, "software": bool(re.search("swiftshader|llvmpipe", str(renderer), re.IGNORECASE)),
    }  # fmt: skip
    finish("view_speed", figures, {"frames_per_second": (">=", 30.0)}, sizes, seconds)


def write_scene(folder: Path, body: jc.Body, motion: jc.Motion) -> None:
    """Write a body, its motion, and scans of 3,000 points with some millimetres of noise."""
    rng = np.random.default_rng(0)
    save_body(folder / "body.npz", body)
    save_motion(folder / "motion.npz", motion, body.skeleton)
    posed = np.asarray(jax.block_until_ready(posed_vertices(body, motion.poses)))
    chosen = rng.integers(0, posed.shape[1], (len(posed), 3000))
    points = np.take_along_axis(posed, chosen[..., None], 1)
    np.savez(folder / "clouds.npz", points=points + 0.005 * rng.normal(size=points.shape))


@contextlib.contextmanager
def run_viewer(
    python: str, folder: Path, *arguments: str, environment: dict[str, str] | None = None
) -> Iterator[str]:
    """Run `jaxcap view` for the duration of the context, and return its address."""
    code = "from jaxcap.cli import main; main()"
    command = [python, "-c", code, "view", *arguments, "--no-browser", "--port", "0"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)} if environment is None else environment
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        line = program.stdout.readline()
        found = re.search(r"http://\S+", line)
        if found is None:
            raise RuntimeError(f"`jaxcap view` printed {line!r}; expected an address.")
        try:
            yield found.group()
        finally:
            program.send_signal(signal.SIGINT)
            program.wait(60)


def measure_installation(folder: Path, angle: str) -> dict[str, float]:
    """Measure the seconds from `pip install` to the human in the browser, in a fresh virtual environment."""
    home = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
    python = str(home / "bin" / "python")
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "JAX_COMPILATION_CACHE_DIR")
    }
    # a copy, as building writes beside the sources
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".git", "build", "dist"))
    with launch_browser(angle) as browser:
        start = time.perf_counter()
        subprocess.run(
            [python, "-m", "pip", "install", "--quiet", f"{source}[view]"],
            check=True,
            env=clean,
            stdout=sys.stderr,
        )
        stages = {"install": time.perf_counter() - start}
        progress(f"installed after {stages['install']:.1f} s")
        with run_viewer(python, folder, "human", environment=clean) as url:
            stages["address"] = time.perf_counter() - start
            page = open_page(browser, url, (800, 600), 300.0)
            wait_for_node(page, SURFACE)
            # drawn once it was there
            page.evaluate(
                "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
            )
            stages["picture"] = time.perf_counter() - start
    progress(f"address after {stages['address']:.1f} s, picture after {stages['picture']:.1f} s")
    return stages


if __name__ == "__main__":
    main()
