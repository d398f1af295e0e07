"""Run Dem-Bones (Le and Deng 2012 and 2014) by py-dem-bones with its default settings.

It finds weights and one free rigid motion a bone and frame; the rest shape is given to it. Its RMSE
is the root mean square over vertices and frames of the distance of a vertex from its place, in the
unit of the meshes. It need not go down from one iteration to the next.
"""

import sys
import time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from benchmarks.report import progress
from jaxcap.observe.meshes import MeshSequence

#: its default, and how many to look at more than once
ITERATIONS, STEP = 30, 5
#: it has stopped where so many iterations have lowered the least RMSE by less than this share
PATIENCE, MIN_DECREASE = 30, 1e-3


class DemBonesRun(NamedTuple):
    """Errors (RMSE, millimetres) and times of Dem-Bones on meshes in metres."""

    bones: int
    #: after its default number of iterations
    rmse: float
    seconds: float
    #: the least on the way to where it stops
    least: float
    seconds_until_it_stops: float
    iterations: int


def dem_bones(
    meshes: MeshSequence,
    bones: int,
    rest: Float[np.ndarray, "V 3"] | None = None,
    limit: float = 600.0,
) -> DemBonesRun:
    """Run Dem-Bones without an initial skin; the seconds include its initialisation.

    The default of `rest` is the first mesh. Iterations continue beyond the default number until they stop to
    lower the error, or for `limit` seconds.
    """
    try:
        from py_dem_bones import DemBones
    except ImportError:
        progress('Dem-Bones is not installed; install it with: pip install -e ".[bench]"')
        sys.exit(2)
    frames, faces = np.asarray(meshes.vertices, float), np.asarray(meshes.faces)
    solver = DemBones()
    solver.nV, solver.nF, solver.nS, solver.nB = frames.shape[1], len(frames), 1, bones
    solver.fStart = np.array([0, len(frames)], np.int32)
    solver.subjectID = np.zeros(len(frames), np.int32)
    solver.u = np.ascontiguousarray((frames[0] if rest is None else np.asarray(rest, float)).T)
    solver.v = np.ascontiguousarray(frames.transpose(0, 2, 1).reshape(-1, frames.shape[1]))
    solver.fv = faces.tolist()
    solver.nIters = STEP

    start = time.perf_counter()
    solver.init()
    spent = time.perf_counter() - start
    errors: list[float] = []
    default = spent
    while True:
        start = time.perf_counter()
        solver.compute()
        spent += time.perf_counter() - start
        errors.append(1000 * solver.rmse())
        done, steps = STEP * len(errors), PATIENCE // STEP
        if done % 10 == 0:
            progress(f"  Dem-Bones, {done} iterations: {errors[-1]:.3f} mm, {spent:.1f} s")
        if done == ITERATIONS:
            default = spent
        if done < ITERATIONS + PATIENCE:
            if spent > limit and done >= ITERATIONS:
                break
            continue
        if min(errors[-steps:]) > (1 - MIN_DECREASE) * min(errors[:-steps]) or spent > limit:
            break
    usual = errors[ITERATIONS // STEP - 1]
    return DemBonesRun(solver.nB, usual, default, min(errors), spent, STEP * len(errors))
