"""Poses of OpenSim models by OpenSim: `python run_osim_forward.py MODEL.osim OUTPUT.npz`.

It runs in the environment of `opensim`, and writes random coordinates within their ranges, rotations of the bodies and positions of the
markers; the first pose has the default values.
"""

import sys

import numpy as np
import opensim

NUM_POSES = 6


def main() -> None:
    path, out = sys.argv[1:]
    opensim.Logger.setLevelString("Error")
    model = opensim.Model(path)
    state = model.initSystem()
    coordinates, bodies, markers = model.getCoordinateSet(), model.getBodySet(), model.getMarkerSet()
    rng = np.random.default_rng(0)
    values, turns, places = [], [], []
    for pose in range(NUM_POSES):
        for number in range(coordinates.getSize()):
            one = coordinates.get(number)
            if one.getLocked(state) or one.isDependent(state):
                continue
            low, high = max(one.getRangeMin(), -3.0), min(one.getRangeMax(), 3.0)
            chosen = float(rng.uniform(low, high)) if pose else one.getDefaultValue()
            one.setValue(state, chosen, False)
        model.assemble(state)
        model.realizePosition(state)
        values.append([coordinates.get(k).getValue(state) for k in range(coordinates.getSize())])
        rotations = [bodies.get(k).getTransformInGround(state).R() for k in range(bodies.getSize())]
        turns.append([[[turn.get(a, b) for b in range(3)] for a in range(3)] for turn in rotations])
        there = [markers.get(k).getLocationInGround(state) for k in range(markers.getSize())]
        places.append([[place[axis] for axis in range(3)] for place in there])
    np.savez(
        out,
        coordinates=[coordinates.get(k).getName() for k in range(coordinates.getSize())],
        angles=[coordinates.get(k).getMotionType() == 1 for k in range(coordinates.getSize())],
        bodies=[bodies.get(k).getName() for k in range(bodies.getSize())],
        markers=np.array([markers.get(k).getName() for k in range(markers.getSize())], dtype=str),
        values=values,
        rotations=turns,
        places=places,
    )


if __name__ == "__main__":
    main()
