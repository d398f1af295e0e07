"""OpenSim models posed here and by OpenSim itself: `python -m benchmarks.osim_models --models FOLDER`.

FOLDER is a checkout of the repository opensim-org/opensim-models. Every model of it that is read is posed at random coordinates, by
OpenSim 4.6 in an environment that is created under --venvs, and here, in float64. Compared are the rotations of bodies, the positions
of markers, and which coordinates are angles. Models that are refused are listed with their sentence.
"""

import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks.markers._rivals.environments import opensim_parser, opensim_python, run_script
from benchmarks.report import finish, progress
from jaxcap.io.opensim.osim import OsimModel

SCRIPT = Path(__file__).parents[1] / "markers" / "_rivals" / "run_osim_forward.py"


def compare(model: OsimModel, theirs: dict[str, np.ndarray]) -> dict[str, float]:
    """Compare rotations of bodies, positions of markers, metres, and kinds of coordinates."""
    names = list(theirs["coordinates"])
    order = [names.index(name) for name in model.model.names]
    bodies = [list(theirs["bodies"]).index(name) for name in model.model.skeleton.names]
    subject, turns, places = model.markers, [], [0.0]
    rest = theirs["rotations"][0][bodies]
    for values, rotations, markers in zip(
        theirs["values"], theirs["rotations"], theirs["places"], strict=True
    ):
        pose = jc.body.pose_from_coordinates(model.model, jnp.asarray(values[order]))
        moved = np.asarray(jc.forward_kinematics(model.model.skeleton, pose).rotations) @ rest
        turns.append(np.abs(moved - rotations[bodies]).max())
        if subject is not None:
            rows = [list(theirs["markers"]).index(label) for label in subject.labels]
            places.append(
                np.abs(np.asarray(jc.markers.marker_positions(subject, pose)) - markers[rows]).max()
            )
    angles = [coordinate.is_angle for coordinate in model.model.coordinates]
    return {
        "rotations": float(max(turns)),
        "markers_m": float(max(places)),
        "other_kinds": float(np.sum(theirs["angles"][order] != angles)),
    }


def main() -> None:
    options = opensim_parser(__doc__).parse_args()
    python = opensim_python(options)
    jax.config.update("jax_enable_x64", True)
    found, refused = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for path in sorted(options.models.rglob("*.osim")):
            try:
                model = jc.io.read_osim(path)
            except jc.InputError as error:
                refused += 1
                progress(f"refused: {error}")
                continue
            out = Path(folder) / "out.npz"
            run_script(python, SCRIPT, path, out)
            with np.load(out) as file:
                found.append(compare(model, dict(file)))
            told = ", ".join(f"{name} {value:.1e}" for name, value in found[-1].items())
            progress(f"{path.relative_to(options.models)}: {told}")
    figures = {name: max(one[name] for one in found) for name in found[0]} | {"refused": float(refused)}
    limits = {"rotations": ("<=", 1e-6), "markers_m": ("<=", 1e-6), "other_kinds": ("<=", 0.0)}
    finish("osim_models", figures, limits, {"models": len(found)}, {})


if __name__ == "__main__":
    main()
