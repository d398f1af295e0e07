"""Motions of the human for other bodies and back: `python -m benchmarks.convert_bodies`.

People of the embedded human perform CMU's motions. Each motion is converted to a body model of other triangles, joints and rest
pose (`_other_body`: T-pose, decimated, 24 joints, 10 coefficients), whose shape is fitted with the motion, and back to the person's
own body. Errors: distances of the model's vertices from their points on the person; after the way back, distances of vertices from
the true surface and from the true vertices, and of joints. `jitter` is the root mean square second difference over time of the
model's vertices, divided by that of their points on the person: above one, the conversion adds noise.

`--to BODY` converts to further bodies of the command line and back, such as `human:male,height=1.9`, `body.npz` or `smplx.npz`.
Without limits, as a body that keeps its own build changes the size of the motion. `--pictures FOLDER` draws some frames of each.
"""

import argparse
from pathlib import Path

import jax
import numpy as np

import jaxcap as jc
from benchmarks._scenes import human_motion, shared_folder
from benchmarks.bodies._other_body import other_model
from benchmarks.report import finish, progress
from jaxcap.body.body_model import BodyModel
from jaxcap.cli.convert.between_bodies import load_target
from jaxcap.edit import ConvertedMotion, convert_motion, match_surfaces
from jaxcap.geometry.attachment import attached_positions
from jaxcap.report.heat_map import front_view
from jaxcap.report.render import CLAY, draw_surface, rotate_view, set_frame

PEOPLE = (
    {"sex": "female", "height": 1.6},
    {"sex": "male", "height": 1.86, "weight": 0.7},
    {"sex": "female", "age": 60, "weight": 0.65},
)
#: takes, and the first frame at 30 frames per second
TAKES = (("02_05", 60), ("01_01", 300), ("02_08", 20))
FRAMES, VERTICES = 50, 6000
#: number of frames in a picture, and the colour of the other body
SHOWN, BLUE = 3, np.array([0.55, 0.72, 0.92])


def run_case(
    person: jc.Body, motion: jc.Motion, target: BodyModel | jc.Body, label: str, pictures: Path | None
) -> dict[str, np.ndarray | float]:
    """Convert a motion there and back; errors in millimetres, and the jitter."""
    match = match_surfaces(person, target)
    there = convert_motion(motion, person, target, match)
    back = convert_motion(there.motion, there.body, person)
    truth, found = (np.asarray(jc.body.posed_vertices(person, m.poses), float) for m in (motion, back.motion))
    faces = np.asarray(person.faces)
    surface = np.array([jc.metrics.scan_to_surface(a, b, faces) for a, b in zip(found, truth, strict=True)])
    joints = [joint_positions(person, m) for m in (motion, back.motion)]
    wanted = np.array([attached_positions(match.attachment, frame) for frame in truth])[:, match.matched]
    posed = np.asarray(jc.body.posed_vertices(there.body, there.motion.poses), float)[:, match.matched]
    if pictures is not None:
        draw(pictures / f"{label}.png", person, motion, there, back)
    return {
        "forward": 1000 * there.error.mean,
        "surface": 1000 * surface,
        "vertices": 1000 * np.linalg.norm(found - truth, axis=2),
        "joints": 1000 * np.linalg.norm(joints[0] - joints[1], axis=2),
        "failed": float(there.error.failed.sum() + back.error.failed.sum()),
        "jitter": float(np.sqrt(np.mean(np.diff(posed, 2, 0) ** 2) / np.mean(np.diff(wanted, 2, 0) ** 2))),
    }


def joint_positions(body: jc.Body, motion: jc.Motion) -> np.ndarray:
    return np.asarray(jax.lax.map(lambda pose: jc.pose_body(body, pose).joints, motion.poses), float)


def tell(label: str, case: dict) -> None:
    forward, surface, vertices, joints = (case[name] for name in ("forward", "surface", "vertices", "joints"))
    progress(
        f"{label}: there {forward.mean():.2f} mm, worst frame {forward.max():.2f}; back: surface {surface.mean():.2f} mm, 95 % "
        f"{np.quantile(surface, 0.95):.2f}, worst frame {surface.mean(1).max():.2f}, vertices {vertices.mean():.2f}, joints "
        f"{joints.mean():.2f}; jitter {case['jitter']:.3f}, {case['failed']:.0f} frames failed"
    )


def draw(
    path: Path, person: jc.Body, motion: jc.Motion, there: ConvertedMotion, back: ConvertedMotion
) -> None:
    """Draw the person, the other body and the person again, in some frames side by side, from two sides."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    frames = np.linspace(0, len(motion) - 1, SHOWN).astype(int)
    rows = (
        ("source", person, motion, CLAY),
        ("converted", there.body, there.motion, BLUE),
        ("and back", person, back.motion, CLAY),
    )
    view = front_view(np.asarray(person.vertices, float))
    figure, axes = plt.subplots(3, 2 * SHOWN, figsize=(2.4 * SHOWN, 6.0))
    for row, (title, body, moving, colour) in zip(axes, rows, strict=True):
        for column, plot in enumerate(row):
            frame, side = int(frames[column // 2]), column % 2
            vertices = np.asarray(jc.body.posed_vertices(body, moving[frame]), float)
            vertices = vertices - 0.5 * (vertices.min(0) + vertices.max(0))
            turned = rotate_view(view, 30.0 + 80.0 * side)
            draw_surface(plot, vertices, np.asarray(body.faces), turned, colour)
            set_frame(plot, np.array([-0.55, -0.9]), np.array([0.55, 0.9]), title if column == 0 else "")
    figure.subplots_adjust(0, 0, 1, 0.97, 0, 0.06)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--people", type=int, default=len(PEOPLE), help="number of people")
    parser.add_argument("--frames", type=int, default=FRAMES, help="number of frames of each motion")
    parser.add_argument("--vertices", type=int, default=VERTICES, help="number of vertices of the model")
    parser.add_argument(
        "--resolution", default="medium", choices=("low", "medium", "full"), help="that of the human"
    )
    parser.add_argument("--to", nargs="*", default=(), metavar="BODY", help="further bodies")
    parser.add_argument("--pictures", type=Path, help="folder for pictures")
    options = parser.parse_args()
    model = other_model(options.vertices, resolution=options.resolution)
    targets = {"other": model, **{spec: load_target(spec) for spec in options.to}}
    cases: dict[str, list[dict]] = {}
    for number, traits in enumerate(PEOPLE[: options.people]):
        person = jc.human(resolution=options.resolution, joints="tracking", **traits)
        take, first = TAKES[number % len(TAKES)]
        motion = human_motion(shared_folder(), take, person, first + options.frames)
        motion = motion.slice(slice(first, first + options.frames))
        for label, target in targets.items():
            case = run_case(person, motion, target, f"{label}_{number}", options.pictures)
            tell(f"person {number}, {take}, {label}", case)
            cases.setdefault(label, []).append(case)
    figures = {}
    for label, found in cases.items():
        stacked = {name: np.array([case[name] for case in found]) for name in found[0]}
        figures |= {
            f"{label}_forward_mm": float(stacked["forward"].mean()),
            f"{label}_forward_worst_frame_mm": float(stacked["forward"].max()),
            f"{label}_round_trip_surface_mm": float(stacked["surface"].mean()),
            f"{label}_round_trip_vertices_mm": float(stacked["vertices"].mean()),
            f"{label}_round_trip_joints_mm": float(stacked["joints"].mean()),
            f"{label}_jitter": float(stacked["jitter"].max()),
            f"{label}_failed": float(stacked["failed"].sum()),
        }
    limits = {
        "other_forward_mm": ("<=", 4.0),
        "other_round_trip_surface_mm": ("<=", 2.0),
        "other_round_trip_vertices_mm": ("<=", 3.0),
        "other_jitter": ("<=", 1.05),
        "other_failed": ("<=", 0.0),
    }
    sizes = {"people": options.people, "frames": options.frames, "vertices": options.vertices}
    finish("convert_bodies", figures, limits, sizes)


if __name__ == "__main__":
    main()
