"""Time calibration, inverse kinematics and streaming of markers: `python -m benchmarks.markers_speed`.

60 markers on the embedded human, 23 joints that move, a take of CMU's at 120 frames per second with noise of a
millimetre, gaps and swapped labels; float32. Solving is timed after a run that compiles; streaming frame by frame
from NumPy arrays to a pose that is there, dispatched synchronously as in `jaxcap markers solve --stream`; calibrating with 100 frames from a wrong template, without and with
compiling. Run it with nothing else beside.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._scenes import shared_folder
from benchmarks.markers._markers import MarkerNoise, make_scene
from benchmarks.report import finish, progress
from jaxcap.cli.markers.streamed import dispatch_synchronously
from jaxcap.markers.calibration.calibrate import calibrate
from jaxcap.markers.motion.inverse_kinematics import solve_markers
from jaxcap.markers.motion.stream import make_streamer, stream_frame


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_speed", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--take", default="02_05")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    dispatch_synchronously()
    scene = make_scene(
        shared_folder(), options.take, MarkerNoise(gaps=0.05, swaps=0.005), frames=options.frames
    )
    subject = eqx.tree_at(lambda s: s.deviations, scene.truth, jnp.full(scene.truth.num_markers, 1e-3))
    count = len(scene.frames)

    solving = []
    for _ in range(options.repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(solve_markers(subject, scene.frames).motion)
        solving.append(time.perf_counter() - start)
        progress(f"solved {count} frames in {solving[-1]:.2f} s")

    streamer, state = make_streamer(subject)
    places, seen = np.asarray(scene.frames.positions), np.asarray(scene.frames.visible)
    latencies = []
    for place, there in zip(places[:1000], seen[:1000], strict=True):
        start = time.perf_counter()
        state, pose = stream_frame(streamer, state, place, there)
        jax.block_until_ready(pose)
        latencies.append(1000 * (time.perf_counter() - start))
    progress(
        f"streaming: median {np.median(latencies):.2f} ms, 99th percentile {np.percentile(latencies, 99):.2f} ms"
    )

    chosen = np.linspace(0, count - 1, min(100, count)).round().astype(int)
    calibrating = []
    for _ in range(2):
        start = time.perf_counter()
        calibrate(scene.frames[chosen], scene.template)
        calibrating.append(time.perf_counter() - start)
        progress(f"calibrated {len(chosen)} frames in {calibrating[-1]:.2f} s")

    figures = {
        "solve_frames_per_second": count / float(np.median(solving[1:])),
        "stream_median_ms": float(np.median(latencies[1:])),
        "stream_p99_ms": float(np.percentile(latencies[1:], 99)),
        "calibrate_seconds": calibrating[-1],
    }
    limits = {
        "solve_frames_per_second": (">=", 5000.0),
        "stream_median_ms": ("<=", 0.25),
        "calibrate_seconds": ("<=", 3.0),
    }
    sizes = {"frames": count, "markers": subject.num_markers, "numbers": subject.skeleton.num_dofs}
    seconds = {"solve_first": solving[0], "calibrate_first": calibrating[0], "solve": solving[1:]}
    finish("markers_speed", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
