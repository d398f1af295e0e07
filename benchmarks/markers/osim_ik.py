"""Inverse kinematics of OpenSim models against OpenSim itself: `python -m benchmarks.osim_ik --models FOLDER`.

FOLDER is a checkout of the repository opensim-org/opensim-models. Its scaled models are solved for its trials of walking, running, a
swinging leg and a bending elbow, with equal weights of all markers and with the weights of its own tasks: here, and by the
tool of OpenSim 4.6 in an environment that is created under --venvs. Both minimise the same sum of squares. Angles are compared in
frames in which OpenSim reaches the same minimum; in the others its sum must be larger. The time is that of its default accuracy.
"""

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks.markers._rivals.environments import opensim_parser, opensim_python, run_script
from benchmarks.report import Timer, finish, progress
from jaxcap.body.coordinates.coordinate_model import pose_from_coordinates
from jaxcap.io.registry import read_marker_file
from jaxcap.markers.motion.label_matching import match_markers
from jaxcap.markers.subject import DEFAULT_DEVIATION


class Pair(NamedTuple):
    """A model, a trial, and tasks if they are not equal weights."""

    model: str
    trial: str
    tasks: str | None = None


_GAIT = "Pipelines/Gait2354_Simbody"
_FEW = "Pipelines/Gait10dof18musc"
_RUN = "Pipelines/Hamner"
PAIRS = {
    "gait2354": Pair(f"{_GAIT}/OutputReference/subject01_simbody.osim", f"{_GAIT}/subject01_walk1.trc"),
    "gait2354_tasks": Pair(
        f"{_GAIT}/OutputReference/subject01_simbody.osim", f"{_GAIT}/subject01_walk1.trc", f"{_GAIT}/subject01_Setup_IK.xml"
    ),
    "gait10": Pair(f"{_FEW}/OutputReference/subject01.osim", f"{_FEW}/ExperimentalData/subject01_walk.trc"),
    "gait10_tasks": Pair(
        f"{_FEW}/OutputReference/subject01.osim", f"{_FEW}/ExperimentalData/subject01_walk.trc",
        f"{_FEW}/OutputReference/IK/walk_Setup_IK.xml",
    ),
    "run": Pair(f"{_RUN}/outputReference/subject02_registered.osim", f"{_RUN}/subject02_running.trc"),
    "run_tasks": Pair(
        f"{_RUN}/outputReference/subject02_registered.osim", f"{_RUN}/subject02_running.trc", f"{_RUN}/Tasks_IK.xml"
    ),
    "leg39": Pair("Models/Leg39/leg39.osim", "Pipelines/Leg39/leg39_swing.trc"),
    "arm26": Pair(
        "Tutorials/Computed_Muscle_Control/InverseKinematics/arm26.osim",
        "Tutorials/Computed_Muscle_Control/InverseKinematics/arm26_elbow_flex.trc",
    ),
}  # fmt: skip
#: energies of one minimum differ by less, relative to them
SAME = 1e-3


def load(pair: Pair, folder: Path):
    """Load the model, its markers with the weights of the tasks, and the targets of its coordinates."""
    model, subject = jc.io.read_osim(folder / pair.model)
    assert subject is not None
    if pair.tasks is None:
        return model, subject, None
    tasks = jc.io.read_ik_tasks(folder / pair.tasks)
    return model, jc.io.weigh_markers(subject, tasks), jc.io.coordinate_targets(model, tasks)


def frame_energies(model, subject, targets, frames, values) -> np.ndarray:
    """Compute the energy of each frame, square metres."""
    matched = match_markers(subject, frames)
    weights = matched.seen * subject.weights

    def of_frame(frame):
        row, places, share = frame
        there = jc.markers.marker_positions(subject, pose_from_coordinates(model, row))
        held = (
            0.0
            if targets is None
            else jnp.sum(targets.weights * (row - targets.values) ** 2) * DEFAULT_DEVIATION**2
        )
        return jnp.sum(share * jnp.sum((there - places) ** 2, 1)) + held

    return np.asarray(jax.lax.map(of_frame, (jnp.asarray(values), matched.positions, weights)))


def measure(name: str, folder: Path, python: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Solve one pair by both."""
    pair = PAIRS[name]
    model, subject, targets = load(pair, folder)
    frames = read_marker_file(folder / pair.trial).frames
    markers = [
        [label, float(weight)]
        for label, weight in zip(subject.labels, subject.weights, strict=True)
        if label in frames.labels and weight > 0
    ]
    held = (
        []
        if targets is None
        else [
            [name, float(weight) * DEFAULT_DEVIATION**2]
            for name, weight in zip(model.names, targets.weights, strict=True)
            if weight > 0
        ]
    )
    with tempfile.TemporaryDirectory() as made:
        tasks, out = Path(made) / "tasks.json", Path(made) / "out.npz"
        tasks.write_text(json.dumps({"markers": markers, "coordinates": held}))
        script = Path(__file__).parent / "_rivals" / "run_osim_ik.py"
        run_script(python, script, tasks, folder / pair.model, folder / pair.trial, out)
        with np.load(out) as file:
            theirs = dict(file)
    timer = Timer()

    def solved():
        return jc.markers.solve_coordinates(model, subject, frames, targets=targets).values

    for _ in range(4):
        values = timer(solved)
    columns = [list(theirs["names"]).index(coordinate) for coordinate in model.names]
    angles = np.array([coordinate.is_angle for coordinate in model.coordinates])
    exact = np.where(angles, np.radians(theirs["exact"][:, columns]), theirs["exact"][:, columns])
    with jax.enable_x64(True):
        again = load(pair, folder)
        ours, other = (frame_energies(*again, frames, one) for one in (values.astype(float), exact))
    same = other <= (1 + SAME) * ours
    free = [number for number in model.free if angles[number]]
    gaps = np.degrees(np.abs(values - exact)[:, free])
    figures = {
        "angle_deg": float(gaps[same].max(initial=0.0)),
        "mean_angle_deg": float(gaps[same].mean()) if same.any() else 0.0,
        "same_minimum": float(same.mean()),
        "not_worse": float((ours <= (1 + SAME) * other).mean()),
        "time_ratio": timer.median / float(theirs["seconds_default"]),
    }
    seconds = {
        "compile": timer.compile,
        "jaxcap": timer.median,
        "opensim": float(theirs["seconds_default"]),
        "opensim_exact": float(theirs["seconds_exact"]),
    }
    progress(
        f"{name}: {len(frames)} frames, {len(free)} angles, {len(markers)} markers: differences of angles {figures['angle_deg']:.4f} "
        f"deg, mean {figures['mean_angle_deg']:.4f}; OpenSim at the same minimum in {100 * figures['same_minimum']:.0f} %; "
        f"{len(frames) / timer.median:.0f} and {len(frames) / seconds['opensim']:.0f} frames a second"
    )
    return figures, seconds


def isb_difference(folder: Path, path: str, knee: int) -> float:
    """Measure the largest difference of angles of hips, knees and ankles by ISB from a model's own coordinates, degrees."""
    model = jc.io.read_osim(folder / path).model
    time = np.linspace(0, 1, 60)
    values = np.tile(np.asarray(model.defaults, float), (len(time), 1))
    rng = np.random.default_rng(0)
    for number, coordinate in enumerate(model.coordinates):
        if coordinate.is_free and coordinate.is_angle and not coordinate.name.startswith(("mtp", "subtalar")):
            low, high = max(float(model.low[number]), -0.6), min(float(model.high[number]), 0.6)
            wave = np.sin(2 * np.pi * rng.uniform(0.5, 2) * time) * (time > 0.05)
            values[:, number] = np.clip(0.0, low, high) + (high - low) / 3 * wave
    angles = jc.joint_angles(model.skeleton, jc.body.motion_from_coordinates(model, values, 60.0))
    gaps = []
    for name in angles.names:
        if name in model.names and name.startswith(("hip", "knee", "ankle", "lumbar")):
            theirs = values[:, model.index(name)]
            sign = knee if name.startswith("knee") else 1
            gaps.append(np.abs(np.asarray(angles[name]) - sign * theirs).max())
    return float(np.degrees(max(gaps)))


def main() -> None:
    parser = opensim_parser(__doc__)
    parser.add_argument("--pairs", nargs="*", default=list(PAIRS), choices=list(PAIRS))
    options = parser.parse_args()
    python = opensim_python(options)
    figures, seconds, limits = {}, {}, {}
    for name in options.pairs:
        found, taken = measure(name, options.models, python)
        figures |= {f"{name}_{key}": value for key, value in found.items()}
        seconds |= {f"{name}_{key}": value for key, value in taken.items()}
        limits |= {
            f"{name}_angle_deg": ("<=", 0.5),
            f"{name}_not_worse": (">=", 1.0),
        }
    total = [sum(seconds[f"{name}_{solver}"] for name in options.pairs) for solver in ("jaxcap", "opensim")]
    figures["time_ratio"] = total[0] / total[1]
    limits["time_ratio"] = ("<=", 1.0)
    # the knee of older models flexes by negative angles
    isb = {"gait2354": (PAIRS["gait2354"].model, -1), "rajagopal": ("Models/Rajagopal/Rajagopal2016.osim", 1)}
    for name, (path, knee) in isb.items():
        figures[f"isb_{name}_deg"] = isb_difference(options.models, path, knee)
        limits[f"isb_{name}_deg"] = ("<=", 2.0)
    finish("osim_ik", figures, limits, {"pairs": len(options.pairs)}, seconds)


if __name__ == "__main__":
    main()
