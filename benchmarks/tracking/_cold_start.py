"""Time a cold start up to the first tracked frame, in a separate process: `python -m benchmarks._cold_start SCENE`.

`SCENE` is an `.npz` with `points`, `normals`, and the start's `translations` and `rotations`. The
last line is JSON: the seconds at which each stage was done, from the first line of this file on.
"""

import json
import sys
import time

began = time.perf_counter()

import jax  # noqa: E402
import numpy as np  # noqa: E402

import jaxcap as jc  # noqa: E402


def main(path: str) -> None:
    stages = {"import": time.perf_counter() - began}
    tracker = jc.make_tracker(jc.human(resolution="medium"))
    stages["tracker"] = time.perf_counter() - began
    with np.load(path, allow_pickle=False) as scene:
        cloud = jc.make_cloud(scene["points"], scene["normals"])
        rest = jc.rest_pose(tracker.body.skeleton)
        start = jc.Pose(
            jax.numpy.asarray(scene["translations"]), jax.numpy.asarray(scene["rotations"]), rest.scale
        )
    stages["cloud"] = time.perf_counter() - began
    frame = jax.block_until_ready(next(jc.fit.track_frames(tracker, [cloud], start=start)))
    stages["first_frame"] = time.perf_counter() - began
    print(json.dumps(stages | {"lost": bool(frame.lost)}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
