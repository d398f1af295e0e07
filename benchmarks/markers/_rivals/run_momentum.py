"""Momentum in an environment of its own: `python run_momentum.py IN.npz OUT.npz`. Centimetres inside.

Settings tried one by one; the one whose markers fit best is taken, as somebody without the truth would.
"""

import sys
import time

import numpy as np
import torch  # noqa: F401  (it has to be loaded before)

import pymomentum.geometry as geometry  # isort: skip
import pymomentum.marker_tracking as tracking
import pymomentum.solver2 as solver

CM = 100.0
#: of its calibration: its damping, the default first (less gives no numbers at all), and its rounds
REGULARIZATIONS, MAJOR = (0.05, 0.02, 0.01, 0.005), (3, 10)


def character_of(scene):
    """Build a character with a free root, three angles per rotating joint, and one length factor per pair of bones."""
    names, parents, centres = [str(n) for n in scene["names"]], scene["parents"], CM * scene["centres"]
    joints, rows, labels = [], [], []
    still = np.array([0.0, 0.0, 0.0, 1.0], np.float32)
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        away = centres[joint] - (centres[parent] if parent >= 0 else 0)
        joints.append(geometry.Joint(name, int(parent), still, away.astype(np.float32)))
    skeleton = geometry.Skeleton(joints)

    def row(entries):
        column = np.zeros(7 * len(names))
        for place, value in entries:
            column[place] = value
        rows.append(column)

    for axis in range(3):
        labels.append(f"root_t{'xyz'[axis]}")
        row([(axis, 1.0)])
    for joint, name in enumerate(names):
        if scene["turns"][joint]:
            for axis in range(3):
                labels.append(f"root_r{'xyz'[axis]}" if joint == 0 else f"{name}_r{'xyz'[axis]}")
                row([(7 * joint + 3 + axis, 1.0)])
    for joint, name in enumerate(names):
        other = int(scene["mirror"][joint])
        away = centres[joint] - centres[parents[joint]]
        if parents[joint] < 0 or other < joint or np.linalg.norm(away) < 0.5:
            continue
        labels.append(f"scale_{name}")
        entries = []
        for one in {joint, other}:
            away = centres[one] - centres[parents[one]]
            entries += [(7 * one + axis, 0.1 * away[axis]) for axis in range(3)]
        row(entries)
    transform = geometry.ParameterTransform(labels, skeleton, np.array(rows, np.float32).T.copy())
    offsets = CM * (scene["offsets"] - scene["centres"][scene["bones"]])
    locators = [
        geometry.Locator(
            name=str(label),
            parent=int(bone),
            offset=offset.astype(np.float32),
            limit_origin=offset.astype(np.float32),
        )
        for label, bone, offset in zip(scene["labels"], scene["bones"], offsets, strict=True)
    ]
    return geometry.Character("human", skeleton, transform, locators=locators)


def markers_of(scene, chosen):
    return [
        [
            geometry.Marker(str(label), CM * place.astype(float), not there)
            for label, place, there in zip(
                scene["labels"], scene["places"][frame], scene["seen"][frame], strict=True
            )
        ]
        for frame in chosen
    ]


def calibrate(scene, chosen, settings):
    character = character_of(scene)
    data = markers_of(scene, chosen)
    config = tracking.CalibrationConfig(calib_frames=len(chosen), **settings)
    start = time.perf_counter()
    identity, _, motion = tracking.calibrate_markers(character, np.zeros(0, np.float32), data, config)
    seconds = time.perf_counter() - start
    motion = np.asarray(motion)
    if not (np.isfinite(identity).all() and np.isfinite(motion).all()):
        return character, identity, seconds, np.inf
    return character, identity, seconds, rms(character, motion, scene, chosen)


def rms(character, motion, scene, frames):
    """Compute the RMS error of the markers, centimetres."""
    parents = np.array([one.parent for one in character.locators], np.int32)
    offsets = np.array([one.offset for one in character.locators], np.float32)
    order = [[str(label) for label in scene["labels"]].index(one.name) for one in character.locators]
    found = np.asarray(
        geometry.model_parameters_to_positions(character, motion.astype(np.float32), parents, offsets)
    )
    if len(found) != len(frames):
        return np.inf
    away = found - CM * scene["places"][frames][:, order]
    return float(np.sqrt((away**2).sum(-1).mean()))


def track(character, identity, scene, settings):
    """Solve every frame from the previous one, with the Gauss-Newton solver and Cholesky."""
    locators, labels = character.locators, [str(label) for label in scene["labels"]]
    parents = np.array([one.parent for one in locators], np.int32)
    offsets = np.array([one.offset for one in locators], np.float32)
    order = [labels.index(one.name) for one in locators]
    targets = (CM * scene["places"][:, order]).astype(np.float32)
    weights = scene["seen"][:, order].astype(np.float32)
    names = character.parameter_transform.names
    active = np.array([not name.startswith("scale_") for name in names])
    error = solver.PositionErrorFunction(character)
    function = solver.SkeletonSolverFunction(character, [error])
    options = solver.GaussNewtonSolverOptions()
    options.max_iterations, options.min_iterations = settings["iterations"], 1
    options.regularization, options.threshold = settings["regularization"], settings["threshold"]
    options.do_line_search = False
    options.use_block_jtj = settings["block"]
    runner = solver.GaussNewtonSolver(function, options)
    runner.set_enabled_parameters(active)
    pose, poses, seconds = np.asarray(identity, np.float32).copy(), [], []
    for frame, (target, weight) in enumerate(zip(targets, weights, strict=True)):
        start = time.perf_counter()
        error.clear_constraints()
        error.add_constraints(parents, target=target, offset=offsets, weight=weight)
        for _ in range(30 if frame == 0 else 1):
            pose = runner.solve(pose)
        seconds.append(time.perf_counter() - start)
        poses.append(pose.copy())
    return np.array(poses), float(np.median(seconds[1:]))


def main():
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    chosen = scene["chosen"]
    geometry.set_log_level(geometry.LogLevel.Error)
    tried = []
    for regularization in REGULARIZATIONS:
        for major in MAJOR:
            settings = dict(regularization=regularization, major_iter=major, max_iter=30)
            character, identity, seconds, left = calibrate(scene, chosen, settings)
            if np.isfinite(left):
                tried.append((left, seconds, character, identity, settings))
            print(f"momentum {settings}: {10 * left:.3f} mm at the markers, {seconds:.1f} s", file=sys.stderr)
    if not tried:
        sys.exit("momentum: no setting gave a finite subject")
    left, seconds, character, identity, settings = min(tried, key=lambda one: one[0])
    best = None
    for trial in (
        dict(iterations=2, regularization=0.01, threshold=1.0, block=False),
        dict(iterations=4, regularization=0.01, threshold=1.0, block=False),
        dict(iterations=4, regularization=0.01, threshold=1.0, block=True),
        dict(iterations=8, regularization=0.01, threshold=1.0, block=True),
    ):
        motion, each = track(character, identity, scene, trial)
        error = rms(character, motion, scene, np.arange(len(motion)))
        print(f"momentum {trial}: {10 * error:.3f} mm at the markers, {1000 * each:.3f} ms", file=sys.stderr)
        if best is None or error < 0.99 * best[0] or (error < 1.01 * best[0] and each < best[2]):
            best = error, motion, each
    states = np.asarray(geometry.model_parameters_to_skeleton_state(character, best[1].astype(np.float32)))
    np.savez(
        sys.argv[2],
        joints=states[..., :3] / CM,
        calibrate_seconds=seconds,
        solve_seconds=best[2],
        markers_mm=10 * best[0],
        settings=str(settings),
    )


if __name__ == "__main__":
    main()
