"""Adapt to scans that are not ordered in time: `python -m benchmarks.adapt_unordered`.

    python -m benchmarks.adapt_unordered --scenes woman crane --frames 12 --short --ordered-too

`woman` and `man` are other people than the template, the embedded human, in frames picked at random from several takes of
the CMU database, each turned to a random side and moved, with 2 mm of noise; `crane` is the capture of Vlasic et al. 2008,
its frames shuffled and its correspondences dropped. `model` is a person of a body model in SMPL's format (`_made_model`) with random
coefficients, in poses picked likewise, to whom the model is adapted. Nothing says that there is no order: it has to be found. A frame's
distance is the median from its points to the body; a frame of more than 10 mm has to be flagged, and where the true surface is known,
one in which it lies more than 5 mm (mean) from the body. With `--ordered-too` the
same scans are adapted to as if they followed each other, for comparison.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._crane import frame_cloud, load_crane
from benchmarks._scenes import cmu_motion, human_motion, rotation_about_y, shared_folder
from benchmarks.bodies._made_model import made_arrays
from benchmarks.report import finish, progress
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import AdaptSettings, AdaptState, plan_stages
from jaxcap.body.body_model import BodyModel
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.geometry.mesh import sample_surface
from jaxcap.metrics import scan_to_surface
from jaxcap.report.distance_pictures import FrameView, draw_views

#: the actors and the takes that their poses are of
PEOPLE = {
    "woman": ({"sex": "female", "weight": 0.35, "height": 1.6}, ("02_05", "02_07", "01_01", "02_08")),
    "man": ({"sex": "male", "weight": 0.9, "height": 1.93}, ("01_08", "02_10", "02_01")),
}
POINTS, NOISE, RATE = 4000, 0.002, 30.0
#: frames of a take that poses are picked from, and metres by which a scan is moved
LENGTH, MAX_SHIFT = 300, 0.4
#: a frame whose median distance is larger is wrong, metres
MAX_MEDIAN_DISTANCE = 0.010
#: a frame in which the true surface is further from the body on average is wrong, metres
MAX_SURFACE_DISTANCE = 0.005
#: frames that are drawn
NUM_DRAWN = 4
SCENES = [*PEOPLE, "crane", "model"]

_posed = eqx.filter_jit(jc.pose_body)


class Scene(NamedTuple):
    """Unordered scans, and the joints and vertices in the world if they are known."""

    clouds: list[jc.Cloud]
    joints: list[np.ndarray]
    vertices: list[np.ndarray]
    #: what is adapted, if it is not the embedded human
    model: BodyModel | None = None


def people_scene(shared: Path, name: str, frames: int, seed: int = 0) -> Scene:
    """Pose an actor in several takes alternately, in random order."""
    traits, takes = PEOPLE[name]
    body = jc.human(joints="tracking", resolution="medium", **traits)
    motions = [human_motion(shared, take, body, LENGTH) for take in takes]
    return pose_scene(body, motions, frames, seed)


def model_scene(shared: Path, frames: int, seed: int = 0) -> Scene:
    """Pose a person of a body model with random coefficients in several takes alternately, in random order."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "smpl_made.npz"
        np.savez(path, **made_arrays())
        model = jc.read_body_model(path, joints="tracking")
    z = np.clip(np.random.default_rng([seed, 2]).normal(size=len(model.template_coefficients)), -2.5, 2.5)
    body = jc.shape_body(model, jnp.asarray(z, jnp.float32))
    takes = (cmu_motion(shared, take) for take in PEOPLE["woman"][1])
    motions = [retarget(motion.slice(slice(LENGTH)), source, body.skeleton) for motion, source in takes]
    return pose_scene(body, motions, frames, seed)._replace(model=model)


def pose_scene(body: jc.Body, motions: Sequence[jc.Motion], frames: int, seed: int) -> Scene:
    """Sample scans of a body in random frames of the motions in turn, in random order."""
    rng = np.random.default_rng([seed, 1])
    clouds, joints, shown = [], [], []
    for number in rng.permutation(frames):
        motion = motions[number % len(motions)]
        posed = _posed(body, motion[int(rng.integers(len(motion)))])
        vertices, centres = np.asarray(posed.vertices, float), np.asarray(posed.joints, float)
        turn, middle = rotation_about_y(rng.uniform(-np.pi, np.pi)), vertices.mean(0) * [1.0, 0.0, 1.0]
        shift = rng.uniform(-MAX_SHIFT, MAX_SHIFT, 3) * [1.0, 0.0, 1.0]
        vertices, centres = ((part - middle) @ turn.T + shift for part in (vertices, centres))
        points, normals = sample_surface(vertices, np.asarray(body.faces), POINTS, rng)
        clouds.append(jc.make_cloud(points + NOISE * rng.normal(size=points.shape), normals))
        joints.append(centres)
        shown.append(vertices)
    return Scene(clouds, joints, shown)


def crane_scene(shared: Path, frames: int, seed: int = 0) -> Scene:
    """Select frames of the capture at equal steps, and shuffle them."""
    crane = load_crane(shared)
    chosen = np.linspace(0, len(crane.frames) - 1, frames).astype(int)
    return Scene(
        [frame_cloud(crane, frame, POINTS) for frame in np.random.default_rng(seed).permutation(chosen)],
        [],
        [],
    )


def distances(state: AdaptState, clouds: list[jc.Cloud]) -> list[np.ndarray]:
    """Compute the distances of the points of every cloud from the surface, metres."""
    faces, found = np.asarray(state.body.faces), []
    for frame, cloud in enumerate(clouds):
        points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
        vertices = np.asarray(_posed(state.body, state.motion[frame]).vertices, float)
        found.append(scan_to_surface(points, vertices, faces))
    return found


def adapt(scene: Scene, settings: AdaptSettings, resolution: str, label: str) -> tuple[AdaptState, bool]:
    """Adapt the template; return the last state, and True if the scans were detected as unordered."""
    if scene.model is None:
        template = jc.human(joints="tracking", resolution=resolution)
    else:
        template = scene.model.template
    task = make_adapt_task(template, scene.clouds, RATE, settings=settings, model=scene.model)
    begin, stages, state = time.perf_counter(), plan_stages(task.settings), None
    for state in adapt_body(task):
        medians = ""
        if stages[state.done - 1].name != "adapt":
            medians = " ".join(f"{1000 * np.median(off):.1f}" for off in distances(state, scene.clouds))
        progress(f"{label}, {stages[state.done - 1]}, {time.perf_counter() - begin:.0f} s: {medians}")
    assert state is not None
    for frame, reason in zip(state.lost, state.reasons, strict=True):
        progress(f"{label}: frame {frame} is lost: {reason}")
    return state, bool(task.settings.unordered)


def score_scene(state: AdaptState, scene: Scene) -> dict[str, float]:
    """Compute all figures of one scene."""
    off = distances(state, scene.clouds)
    medians = np.array([np.median(frame) for frame in off])
    wrong = set(np.flatnonzero(medians > MAX_MEDIAN_DISTANCE).tolist())
    row = {
        "median_mm": 1000 * float(np.median(np.concatenate(off))),
        "worst_frame_mm": 1000 * float(medians.max()),
        "wrong_frames": float(len(wrong)),
        "unflagged": float(len(wrong - set(state.lost))),
        "flagged": float(len(state.lost)),
    }
    if scene.vertices:
        faces = np.asarray(state.body.faces)
        pairs = zip(scene.vertices, state.motion, strict=True)
        surface = [
            scan_to_surface(true, np.asarray(_posed(state.body, pose).vertices, float), faces).mean()
            for true, pose in pairs
        ]
        off_surface = set(np.flatnonzero(np.array(surface) > MAX_SURFACE_DISTANCE).tolist())
        row |= {
            "surface_mm": 1000 * float(np.median(surface)),
            "worst_surface_mm": 1000 * float(np.max(surface)),
            "unflagged_surface": float(len(off_surface - set(state.lost))),
        }
    if scene.joints:
        here = [np.asarray(_posed(state.body, state.motion[n]).joints) for n in range(len(scene.clouds))]
        by_frame = np.linalg.norm(np.array(here) - np.array(scene.joints), axis=2).mean(1)
        row |= {
            "joints_mm": 1000 * float(np.median(by_frame)),
            "worst_joints_mm": 1000 * float(by_frame.max()),
        }
    return row


def picture(path: Path, state: AdaptState, scene: Scene) -> None:
    """Draw the frames with the largest errors."""
    off, views = distances(state, scene.clouds), []
    for frame in np.argsort([-np.median(one) for one in off])[:NUM_DRAWN].tolist():
        vertices = np.asarray(_posed(state.body, state.motion[frame]).vertices)
        title = f"frame {frame}: {1000 * np.median(off[frame]):.1f} mm"
        points = np.asarray(scene.clouds[frame].points)[np.asarray(scene.clouds[frame].weights) > 0]
        views.append(FrameView(title, vertices, points, off[frame]))
    draw_views(path, views, np.asarray(state.body.faces), "Frames with the largest errors")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.adapt_unordered", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=SCENES)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--resolution", default="medium", help="resolution of the template: medium or low")
    parser.add_argument("--short", action="store_true", help="few rounds with 8 scans")
    parser.add_argument(
        "--ordered-too", action="store_true", help="adapt also as if the scans were ordered in time"
    )
    parser.add_argument(
        "--pictures", type=Path, help="folder for pictures of the frames with the largest errors"
    )
    options = parser.parse_args()
    settings = (
        AdaptSettings(num_frames=8, proportion_rounds=3, rounds=(2, 2)) if options.short else AdaptSettings()
    )
    shared, begin = shared_folder(), time.perf_counter()
    figures, limits = {}, {}
    for name in options.scenes:
        if name == "crane":
            scene = crane_scene(shared, options.frames)
        elif name == "model":
            scene = model_scene(shared, options.frames)
        else:
            scene = people_scene(shared, name, options.frames)
        state, found = adapt(scene, settings, options.resolution, name)
        figures |= {f"{name}_found": float(found)} | {
            f"{name}_{k}": v for k, v in score_scene(state, scene).items()
        }
        limits |= {
            f"{name}_found": ("==", 1.0),
            f"{name}_wrong_frames": ("<=", 0.0),
            f"{name}_unflagged": ("<=", 0.0),
        }
        if scene.vertices:
            limits[f"{name}_unflagged_surface"] = ("<=", 0.0)
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            picture(options.pictures / f"{name}.png", state, scene)
        if options.ordered_too:
            state, _ = adapt(
                scene, settings._replace(unordered=False), options.resolution, f"{name} as ordered"
            )
            figures |= {f"{name}_ordered_{key}": value for key, value in score_scene(state, scene).items()}
            limits[f"{name}_ordered_unflagged"] = ("<=", 0.0)
    sizes = {
        "frames": options.frames,
        "points": POINTS,
        "template": options.resolution,
        "short": options.short,
    }
    finish("adapt_unordered", figures, limits, sizes, {"run": time.perf_counter() - begin})


if __name__ == "__main__":
    main()
