"""Frame-by-frame solution of a trial, as in live use, with the computing time of each frame."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose, stack_poses
from ...energy.energy import AbstractEnergy
from ...markers.calibration.residuals import marker_residuals
from ...markers.motion.inverse_kinematics import MarkerSolution
from ...markers.motion.label_matching import match_markers
from ...markers.motion.stream import make_streamer, stream_frame
from ...markers.subject import Subject
from ...observe.markers import MarkerFrames


class Latency(NamedTuple):
    """Seconds from a frame's markers to its pose; compilation comes before the first."""

    seconds: Float[np.ndarray, "F"]

    def report(self) -> dict[str, float]:
        """Return the statistics for JSON, seconds."""
        median, late, worst = self._figures()
        return {"median": median, "p99": late, "worst": worst, "frames": len(self.seconds)}

    def sentence(self) -> str:
        """Format the statistics as one line."""
        median, late, worst = (1e3 * figure for figure in self._figures())
        return (
            f"latency: median {median:.2f} ms per frame, 99 % within {late:.2f} ms, the slowest {worst:.2f} ms "
            f"({len(self.seconds)} frames, one by one)"
        )

    def _figures(self) -> tuple[float, float, float]:
        return (
            float(np.median(self.seconds)),
            float(np.percentile(self.seconds, 99)),
            float(self.seconds.max()),
        )


def dispatch_synchronously() -> None:
    """Compute each function in the thread that calls it, before any computation: a frame then waits for no thread to wake up."""
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def solve_streamed(
    subject: Subject, frames: MarkerFrames, terms: Sequence[AbstractEnergy] = ()
) -> tuple[MarkerSolution, Latency]:
    """Solve the motion of frames that arrive one by one, and measure the time of each.

    **Raises:** `ValueError` if frames and subject share no label.
    """
    matched = match_markers(subject, frames)
    places, seen = np.asarray(matched.positions), np.asarray(matched.seen)
    streamer, state = make_streamer(subject, terms=terms)
    poses: list[Pose] = []
    seconds, lost = np.zeros(len(places)), np.zeros(len(places), bool)
    for frame in range(len(places)):
        start = time.perf_counter()
        state, pose = stream_frame(streamer, state, places[frame], seen[frame])
        jax.block_until_ready(pose)
        seconds[frame] = time.perf_counter() - start
        lost[frame] = int(state.num_lost) > 0
        poses.append(pose)
    motion = stack_poses(poses, frames.rate)
    lengths = np.asarray(_lengths(subject, motion.poses, matched.positions))
    residuals = np.where(seen, lengths, np.nan)
    messages = (
        ()
        if not lost.any()
        else (f"{int(lost.sum())} of {len(lost)} frames are lost and keep the previous pose.",)
    )
    return MarkerSolution(motion, residuals, 1.0 * (seen & ~lost[:, None]), lost, messages), Latency(seconds)


@eqx.filter_jit
def _lengths(subject: Subject, poses: Pose, places: Float[Array, "F M 3"]) -> Float[Array, "F M"]:
    return jax.lax.map(
        lambda frame: jnp.linalg.norm(marker_residuals(subject, *frame), axis=1), (poses, places)
    )
