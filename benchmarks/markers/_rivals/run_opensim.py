"""OpenSim in an environment of its own: `python run_opensim.py IN.npz OUT.npz`. Inverse kinematics of a given subject.

OpenSim scales a model by distances between markers of a static trial, which tells no joint centre; so it is given
the subject that was calibrated by the other side, and only the solves are compared.
"""

import os
import sys
import tempfile
import time

import numpy as np
import opensim

#: accuracies of its assembler, from its default on
ACCURACIES = (1e-5, 1e-4, 1e-3)


def model_of(scene):
    model, bodies, zero = opensim.Model(), [], opensim.Vec3(0)
    names, parents, centres = [str(n) for n in scene["names"]], scene["parents"], scene["own_centres"]
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        body = opensim.Body(name, 1.0, zero, opensim.Inertia(1, 1, 1, 0, 0, 0))
        model.addBody(body)
        base = model.getGround() if parent < 0 else bodies[parent]
        away = centres[joint] - (centres[parent] if parent >= 0 else 0)
        kind = (
            opensim.FreeJoint
            if parent < 0
            else opensim.BallJoint
            if scene["turns"][joint]
            else opensim.WeldJoint
        )
        place = opensim.Vec3(*map(float, away))
        model.addJoint(kind(f"{name}_joint", base, place, zero, body, zero, zero))
        bodies.append(body)
    offsets = scene["own_offsets"] - centres[scene["bones"]]
    for label, bone, offset in zip(scene["labels"], scene["bones"], offsets, strict=True):
        model.addMarker(opensim.Marker(str(label), bodies[bone], opensim.Vec3(*map(float, offset))))
    model.finalizeConnections()
    return model


def write_trc(path, scene):
    """Write markers as a TRC file, from which OpenSim reads references."""
    places, labels, rate = scene["places"], [str(label) for label in scene["labels"]], float(scene["rate"])
    with open(path, "w") as file:
        file.write(f"PathFileType\t4\t(X/Y/Z)\t{os.path.basename(path)}\n")
        file.write(
            "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
        )
        file.write(f"{rate}\t{rate}\t{len(places)}\t{len(labels)}\tm\t{rate}\t1\t{len(places)}\n")
        file.write("Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t\n\t\t")
        file.write("\t".join(f"{axis}{n + 1}" for n in range(len(labels)) for axis in "XYZ") + "\n\n")
        for frame, row in enumerate(places):
            file.write(
                f"{frame + 1}\t{frame / rate:.9f}\t" + "\t".join(f"{x:.9f}" for x in row.ravel()) + "\n"
            )


def solve(scene, path, accuracy):
    model, labels = model_of(scene), [str(label) for label in scene["labels"]]
    weights = opensim.SetMarkerWeights()
    for label in labels:
        weights.cloneAndAppend(opensim.MarkerWeight(label, 1.0))
    state = model.initSystem()
    markers = opensim.MarkersReference(path, weights)
    solver = opensim.InverseKinematicsSolver(model, markers, opensim.SimTKArrayCoordinateReference())
    solver.setAccuracy(accuracy)
    rate, count = float(scene["rate"]), len(scene["places"])
    state.setTime(0.0)
    solver.assemble(state)
    joints, seconds = np.zeros((count, len(scene["names"]), 3)), []
    bodies = [model.getBodySet().get(str(name)) for name in scene["names"]]
    left = []
    for frame in range(count):
        state.setTime(frame / rate)
        start = time.perf_counter()
        solver.track(state)
        seconds.append(time.perf_counter() - start)
        model.realizePosition(state)
        joints[frame] = [body.getPositionInGround(state).to_numpy() for body in bodies]
        left.append([solver.computeCurrentSquaredMarkerError(label) for label in labels])
    return joints, float(np.median(seconds[1:])), 1000 * float(np.sqrt(np.mean(left)))


def main():
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    opensim.Logger.setLevelString("Off")
    best = None
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "markers.trc")
        write_trc(path, scene)
        for accuracy in ACCURACIES:
            joints, each, left = solve(scene, path, accuracy)
            print(
                f"opensim accuracy {accuracy}: {left:.3f} mm at the markers, {1000 * each:.3f} ms",
                file=sys.stderr,
            )
            if best is None or left < 0.99 * best[2] or (left < 1.01 * best[2] and each < best[1]):
                best = joints, each, left
    np.savez(sys.argv[2], joints=best[0], solve_seconds=best[1], markers_mm=best[2])


if __name__ == "__main__":
    main()
