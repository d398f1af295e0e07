"""nimblephysics in an environment of its own: `python run_nimblephysics.py IN.npz OUT.npz`.

Settings tried one by one; the one whose markers fit best is taken, as somebody without the truth would.
"""

import os
import sys
import tempfile
import time

import nimblephysics as nimble
import numpy as np

#: of its calibration: how stiffly markers keep to their places (10 is its default), whether bones with one child
#: keep their shape as they are scaled, and whether it looks for centres of joints before, which bones of two markers
#: lead astray; its defaults come last. Less stiffness fits the markers better and the joints worse, which the rule above
#: would not see: 1 has 7 and 13 mm, 0.1 has 4 and 23 mm
SETTINGS = (
    dict(stiffness=3.0, uniform=True, centres=False),
    dict(stiffness=10.0, uniform=False, centres=True),
)
#: no further setting is tried after so many seconds
MAX_DISTANCE_MM = 500.0
#: of its solves: damping of its least squares, and whether it searches along each step
SOLVES = (dict(damping=1e-2, search=True), dict(damping=1e-4, search=False))


def skeleton_of(scene, centres):
    names, parents = [str(name) for name in scene["names"]], scene["parents"]
    skeleton, bodies = nimble.dynamics.Skeleton(), []
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        kind = "Free" if parent < 0 else "Ball" if scene["turns"][joint] else "Weld"
        make = getattr(skeleton, f"create{kind}JointAndBodyNodePair")
        joined, body = make() if parent < 0 else make(bodies[parent])
        joined.setName(f"{name}_joint")
        body.setName(name)
        place = nimble.math.Isometry3()
        place.set_translation(centres[joint] - (centres[parent] if parent >= 0 else 0))
        joined.setTransformFromParentBodyNode(place)
        body.setScaleLowerBound(np.full(3, 0.5))
        body.setScaleUpperBound(np.full(3, 2.0))
        bodies.append(body)
    return skeleton, bodies


def add_meshes(scene, bodies, centres, folder):
    """Add slivers from each joint to its markers and children, as nimblephysics takes the height from meshes."""
    for joint, body in enumerate(bodies):
        ends = [np.array([0.0, 0.02, 0.0])]
        ends += [centres[child] - centres[joint] for child in np.flatnonzero(scene["parents"] == joint)]
        ends += list(scene["offsets"][scene["bones"] == joint] - centres[joint])
        path = os.path.join(folder, f"{joint}.obj")
        with open(path, "w") as file:
            for end in ends:
                for corner in (np.zeros(3), end, end + 0.005):
                    file.write("v {:.6f} {:.6f} {:.6f}\n".format(*corner))
            for number in range(len(ends)):
                file.write(f"f {3 * number + 1} {3 * number + 2} {3 * number + 3}\n")
        body.createShapeNode(nimble.dynamics.MeshShape(np.ones(3), path)).createVisualAspect()


def markers_of(scene, bodies, offsets, centres):
    local = offsets - centres[scene["bones"]]
    return {
        str(label): (bodies[bone], place.astype(float))
        for label, bone, place in zip(scene["labels"], scene["bones"], local, strict=True)
    }


def observe(scene, frames):
    return [
        {
            str(label): scene["places"][frame, marker].astype(float)
            for marker, label in enumerate(scene["labels"])
            if scene["seen"][frame, marker]
        }
        for frame in frames
    ]


def calibrate(scene, folder, stiffness, uniform, centres):
    """Calibrate; return the skeleton, its marker offsets, seconds, and marker errors, metres."""
    skeleton, bodies = skeleton_of(scene, scene["centres"])
    add_meshes(scene, bodies, scene["centres"], folder)
    for bone, other in enumerate(scene["mirror"]):
        if other > bone:
            skeleton.mergeScaleGroups(bodies[bone], bodies[int(other)])
    for bone, body in enumerate(bodies):
        if uniform and np.sum(scene["parents"] == bone) <= 1:
            skeleton.setScaleGroupUniformScaling(body, True)
    fitter = nimble.biomechanics.MarkerFitter(
        skeleton, markers_of(scene, bodies, scene["offsets"], scene["centres"])
    )
    fitter.setInitialIKSatisfactoryLoss(1e-5)
    fitter.setInitialIKMaxRestarts(50)
    fitter.setIterationLimit(300)
    fitter.setRegularizeAnatomicalMarkerOffsets(stiffness)
    if not centres:
        fitter.setMaxJointWeight(0.0)
        fitter.setMaxAxisWeight(0.0)
    seen = observe(scene, scene["chosen"])
    start = time.perf_counter()
    found = fitter.runKinematicsPipeline(
        seen, [False] * len(seen), nimble.biomechanics.InitialMarkerFitParams(), 50
    )
    seconds = time.perf_counter() - start
    skeleton.setGroupScales(found.groupScales)
    markers = {label: found.updatedMarkerMap[str(label)] for label in map(str, scene["labels"])}
    skeleton.setPositions(found.poses[:, 0])
    off = nimble.biomechanics.IKErrorReport(skeleton, markers, found.poses, seen).averageRootMeanSquaredError
    return skeleton, bodies, markers, np.array(found.poses[:, 0]), seconds, float(off)


def track(scene, skeleton, bodies, markers, pose, damping, search):
    """Solve every frame from the previous one; return joints, seconds per frame, and marker errors, metres."""
    order, count = list(markers.values()), len(scene["places"])
    joints, seconds, left = np.zeros((count, len(bodies), 3)), [], []
    skeleton.setPositions(pose)
    for frame in range(count):
        places, there = scene["places"][frame].astype(float), scene["seen"][frame].astype(float)
        start = time.perf_counter()
        skeleton.fitMarkersToWorldPositions(order, places.ravel(), there, False, 1e-7, 20, 1, damping, search)
        seconds.append(time.perf_counter() - start)
        joints[frame] = [body.getWorldTransform().translation() for body in bodies]
        away = skeleton.getMarkerWorldPositions(order).reshape(-1, 3) - places
        left.append(((away**2).sum(1) * there).sum() / there.sum())
    return joints, float(np.median(seconds[1:])), float(np.sqrt(np.mean(left)))


def main():
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    tried, begun = [], time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for settings in SETTINGS:
            if tried and time.perf_counter() - begun > MAX_DISTANCE_MM:
                break
            tried.append((*calibrate(scene, folder, **settings), settings))
            *_, seconds, off, _ = tried[-1]
            print(
                f"nimblephysics {settings}: {1000 * off:.3f} mm at the markers, {seconds:.1f} s",
                file=sys.stderr,
                flush=True,
            )
        skeleton, bodies, markers, pose, seconds, _, settings = min(tried, key=lambda one: one[5])
        best = None
        for trial in SOLVES:
            joints, each, off = track(scene, skeleton, bodies, markers, pose, **trial)
            print(
                f"nimblephysics {trial}: {1000 * off:.3f} mm at the markers, {1000 * each:.3f} ms",
                file=sys.stderr,
                flush=True,
            )
            if best is None or off < 0.99 * best[2] or (off < 1.01 * best[2] and each < best[1]):
                best = joints, each, off
    np.savez(
        sys.argv[2],
        joints=best[0],
        calibrate_seconds=seconds,
        solve_seconds=best[1],
        markers_mm=1000 * best[2],
        settings=str(settings),
    )


if __name__ == "__main__":
    main()
