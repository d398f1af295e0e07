"""Inverse kinematics by OpenSim: `python run_osim_ik.py TASKS.json MODEL.osim TRIAL.trc OUTPUT.npz`.

It runs in the environment of `opensim`. The tasks are pairs of names and weights of markers, and of coordinates, which are held at
their default values. It writes the coordinates at two accuracies and the seconds of each.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import opensim

#: the default of the tool, and one at which the minimum is exact
ACCURACIES = {"default": 1e-5, "exact": 1e-9}


def main() -> None:
    tasks, model_path, trial, out = sys.argv[1:]
    wanted = json.loads(Path(tasks).read_text())
    opensim.Logger.setLevelString("Error")
    table = opensim.TimeSeriesTableVec3(trial)
    times = table.getIndependentColumn()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, accuracy in ACCURACIES.items():
            model = opensim.Model(model_path)
            model.initSystem()
            tool = opensim.InverseKinematicsTool()
            tool.setModel(model)
            tool.setMarkerDataFileName(trial)
            tool.setStartTime(times[0])
            tool.setEndTime(times[-1])
            motion = str(Path(folder) / "out.mot")
            tool.setOutputMotionFileName(motion)
            tool.set_accuracy(accuracy)
            tool.set_report_errors(False)
            of = tool.upd_IKTaskSet()
            for label, weight in wanted["markers"]:
                task = opensim.IKMarkerTask()
                task.setName(label)
                task.setWeight(weight)
                of.cloneAndAppend(task)
            for coordinate, weight in wanted["coordinates"]:
                task = opensim.IKCoordinateTask()
                task.setName(coordinate)
                task.setWeight(weight)
                task.setValueType(opensim.IKCoordinateTask.DefaultValue)
                of.cloneAndAppend(task)
            start = time.perf_counter()
            tool.run()
            found[f"seconds_{name}"] = time.perf_counter() - start
            lines = Path(motion).read_text().splitlines()
            first = next(number for number, line in enumerate(lines) if line.strip() == "endheader") + 1
            found["names"] = np.array(lines[first].split()[1:])
            found[name] = np.array(
                [[float(cell) for cell in line.split()[1:]] for line in lines[first + 1 :]]
            )
    np.savez(out, **found)


if __name__ == "__main__":
    main()
