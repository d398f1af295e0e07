"""Register scans to one topology, and learn bodies from them: `python -m benchmarks.register`.

    python -m benchmarks.register --people 1 --no-crane --picture register.png

Made people are embedded humans of other builds than the template, with bumps like hair and cloth (`adapt_people`), in
poses of CMU's takes. The crane capture is a real subject in clothes. A scan is a cloud of random points of the true
surface with 2 mm of noise and tilted normals; nothing else goes in. The template is the average embedded human.

The surface error is the distance of the true vertices from the registered surface. The correspondence error of made people
is the distance along the surface of each vertex from the same vertex of the true body. The vertices of crane have no
counterparts in the template: there each registered vertex is attached to a point of the true mesh in every frame, and the
error is the distance of these points from their median, in the first frame's pose. A body is then learned from the
registered meshes with default options but a few rounds only, another one from the true meshes with the same options. The poses of
both are fitted to the true surfaces of held-out frames, without correspondences, which differ between the two.

`--guide-degrees` measures the registration by itself, in minutes: the guide is the made person without bumps, in the true
poses with every joint rotated by so many degrees (standard deviation, about each axis) and the root shifted by 3 mm.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxcap as jc
from benchmarks._crane import load_crane
from benchmarks._scenes import Noise, add_noise, human_motion, shared_folder
from benchmarks.adaptation.adapt_people import ACTORS, TAKES, make_actor
from benchmarks.learning._learning import learn, posed_vertices
from benchmarks.report import finish, progress
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.poses.fit_frame import fit_task_poses
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.registration.collect import RegisteredMeshes, collect_registered
from jaxcap.adapt.registration.register_scans import register_scans
from jaxcap.adapt.task import AdaptSettings, AdaptState, plan_stages
from jaxcap.body.retraction import retract
from jaxcap.fit.fit_meshes import fit_meshes
from jaxcap.geometry.closest import nearest_on_surface, positions_on_surface
from jaxcap.geometry.mesh import sample_surface, vertex_normals
from jaxcap.metrics import scan_to_surface
from jaxcap.observe.meshes import MeshSequence
from jaxcap.report.distance_pictures import FrameView, draw_views

NOISE = Noise(points=20_000, deviation=0.002, tilt=10.0, outliers=0.0)
#: a scan of the true surface, to which poses of learned bodies are fitted; the steps, and the weight of the prior of poses
EXACT = Noise(points=30_000, deviation=0.0, tilt=0.0, outliers=0.0)
POSE_STEPS, PRIOR_WEIGHT = 10, 1e-12
#: frames of a take between two scans
STRIDE = 8
#: standard deviation of the root of a perturbed guide, metres
ROOT_SHIFT = 0.003
#: every so many scans one is held out
HOLD_OUT = 4


class Subject(NamedTuple):
    """The true meshes of a person, in the frames of the scans."""

    name: str
    vertices: Float[np.ndarray, "F V 3"]
    faces: Int[np.ndarray, "T 3"]
    #: the template has the same triangles
    corresponds: bool


class Result(NamedTuple):
    """A registration of a subject's scans."""

    clouds: list[jc.Cloud]
    state: AdaptState
    registered: RegisteredMeshes


def make_person(number: int, count: int) -> Subject:
    """Pose a made person in frames of a take."""
    actor = make_actor(ACTORS[number]).body
    motion = human_motion(shared_folder(), TAKES[number], actor, STRIDE * count)
    motion = motion.slice(slice(None, None, STRIDE))
    return Subject(f"person_{number}", posed_vertices(actor, motion), np.asarray(actor.faces), True)


def crane_subject(count: int) -> Subject:
    """Take frames of the capture at equal distances, from its beginning."""
    crane = load_crane(shared_folder())
    stride = min(STRIDE, len(crane.frames) // count)
    return Subject("crane", crane.frames[: stride * count : stride].astype(float), crane.faces, False)


def scan(subject: Subject, frame: int, noise: Noise = NOISE) -> jc.Cloud:
    """Sample a noisy cloud of a frame."""
    rng = np.random.default_rng([7, frame])
    points, normals = sample_surface(subject.vertices[frame], subject.faces, noise.points, rng)
    return jc.make_cloud(*add_noise(points, normals, noise, rng))


def register(template: jc.Body, subject: Subject, rounds: tuple[int, ...]) -> Result:
    """Adapt the template to the scans of a subject, and register them."""
    clouds = [scan(subject, frame) for frame in range(len(subject.vertices))]
    settings = AdaptSettings(rounds=rounds, temporal_weight=0.0, unordered=False)
    task = make_adapt_task(template, clouds, 30.0 / STRIDE, settings=settings, planes=())
    stages, state = plan_stages(settings), None
    for state in adapt_body(task):
        progress(f"{subject.name}: {stages[state.done - 1]}, {state.history[-1][1]:.2f} mm")
    assert state is not None
    registered = collect_registered(state.body, register_scans(task, state), task.rate)
    for frame, reason in registered.failures.items():
        progress(f"{subject.name}: frame {frame} failed: {reason}")
    return Result(clouds, state, registered)


def register_by_person(number: int, subject: Subject, degrees: float) -> Result:
    """Register scans of a made person by the same person without bumps, in perturbed poses."""
    count, rng = len(subject.vertices), np.random.default_rng(0)
    body = jc.human(joints="tracking", resolution="medium", **ACTORS[number])
    motion = human_motion(shared_folder(), TAKES[number], body, STRIDE * count)
    poses = []
    for frame in range(count):
        step = np.radians(degrees) * rng.normal(size=body.skeleton.num_dofs)
        step[:3] = ROOT_SHIFT * rng.normal(size=3)
        poses.append(retract(body.skeleton, motion[STRIDE * frame], jnp.asarray(step, jnp.float32)))
    clouds = [scan(subject, frame) for frame in range(count)]
    task = make_adapt_task(body, clouds, settings=AdaptSettings(unordered=False), planes=())
    state = AdaptState(len(plan_stages(task.settings)), body, 1.0, jc.stack_poses(poses, task.rate))
    return Result(clouds, state, collect_registered(body, register_scans(task, state), task.rate))


def surface_errors(subject: Subject, result: Result, vertices: Float[np.ndarray, "F W 3"]):
    """Compute the distances of the true vertices from surfaces in the registered frames, metres."""
    faces = np.asarray(result.registered.meshes.faces)
    return np.concatenate(
        [
            scan_to_surface(subject.vertices[frame], surface, faces)
            for frame, surface in zip(result.registered.frames, vertices, strict=True)
        ]
    )


def correspondence_errors(subject: Subject, result: Result, vertices: Float[np.ndarray, "F W 3"]):
    """Compute the errors of vertices along the surface, metres."""
    if subject.corresponds:
        truth = subject.vertices[list(result.registered.frames)]
        normals = np.stack([np.asarray(vertex_normals(each, subject.faces)) for each in truth])
        off = vertices - truth
        return np.linalg.norm(off - np.sum(off * normals, 2, keepdims=True) * normals, axis=2).ravel()
    points = []
    for frame, surface in zip(result.registered.frames, vertices, strict=True):
        nearest = nearest_on_surface(surface, subject.vertices[frame], subject.faces)
        points.append(positions_on_surface(nearest, subject.vertices[0], subject.faces))
    return np.linalg.norm(np.array(points) - np.median(points, axis=0), axis=2).ravel()


def guide_vertices(result: Result) -> Float[np.ndarray, "F W 3"]:
    """Pose the adapted body in the registered frames."""
    frames = np.array(result.registered.frames)
    poses = jax.tree.map(lambda leaf: leaf[frames], result.state.motion.poses)
    return posed_vertices(result.state.body, jc.Motion(poses, 30.0))


def learned_error(meshes: MeshSequence, subject: Subject, frames: Sequence[int], options: dict) -> float:
    """Learn from the meshes that are not held out, fit poses to the true surfaces of the others, and compute the mean distance
    of the true vertices from the fitted surfaces, millimetres."""
    held = np.arange(len(meshes)) % HOLD_OUT == HOLD_OUT - 1
    body = learn(meshes[np.flatnonzero(~held)], **options).body
    starts = fit_meshes(body, meshes[np.flatnonzero(held)]).motion
    others = np.asarray(frames)[held].tolist()
    surfaces = [scan(subject, frame, EXACT) for frame in others]
    task = make_adapt_task(body, surfaces, settings=AdaptSettings(unordered=False), planes=())
    state = AdaptState(0, body, 1.0, starts, pose_weight=PRIOR_WEIGHT)
    scans, first = (task.scan(number) for number in task.scanned), (starts[number] for number in task.scanned)
    fits = fit_task_poses(task, state, scans, first, steps=POSE_STEPS)
    fitted = posed_vertices(body, jc.stack_poses([fit.pose for fit in fits], 30.0))
    faces = np.asarray(meshes.faces)
    pairs = zip(subject.vertices[others], fitted, strict=True)
    return 1000 * float(np.mean([scan_to_surface(points, surface, faces) for points, surface in pairs]))


def measure(subject: Subject, result: Result, options: dict | None) -> dict[str, float]:
    """Compute the figures of a subject; without `options` of learning no body is learned."""
    vertices = np.asarray(result.registered.meshes.vertices, float)
    guides = guide_vertices(result).astype(float)
    row = {
        "surface_mm": 1000 * float(np.median(surface_errors(subject, result, vertices))),
        "surface_percentile_90_mm": 1000 * float(np.quantile(surface_errors(subject, result, vertices), 0.9)),
        "correspondence_mm": 1000 * float(np.median(correspondence_errors(subject, result, vertices))),
        "guide_surface_mm": 1000 * float(np.median(surface_errors(subject, result, guides))),
        "guide_correspondence_mm": 1000 * float(np.median(correspondence_errors(subject, result, guides))),
        "failed": float(len(result.registered.failures)),
        "seen_percent": 100 * float(result.registered.seen.mean()),
    }
    if options is not None:
        truth = subject.vertices[list(result.registered.frames)]
        true_meshes = MeshSequence(jnp.asarray(truth, jnp.float32), subject.faces, 30.0)
        frames = result.registered.frames
        ours = learned_error(result.registered.meshes, subject, frames, options)
        theirs = learned_error(true_meshes, subject, frames, options)
        row |= {"learned_mm": ours, "learned_from_truth_mm": theirs, "learned_ratio": ours / theirs}
    progress(f"{subject.name}: " + ", ".join(f"{key} {value:.3g}" for key, value in row.items()))
    return row


def draw(path: Path, subject: Subject, result: Result) -> None:
    """Draw the registered surface with the points of the scan in a few frames."""
    registered, views = result.registered, []
    for n in sorted({0, len(registered.frames) // 2, len(registered.frames) - 1}):
        frame, vertices = registered.frames[n], np.asarray(registered.meshes.vertices[n], float)
        cloud = result.clouds[frame]
        points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0][::3]
        distances = scan_to_surface(points, vertices, np.asarray(registered.meshes.faces))
        views.append(FrameView(f"frame {frame}", vertices, points, distances))
    draw_views(
        path.with_stem(f"{path.stem}-{subject.name}"),
        views,
        np.asarray(registered.meshes.faces),
        f"The human, registered to scans of {subject.name}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.register", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--people", type=int, default=2, help=f"number of made people, at most {len(ACTORS)}")
    parser.add_argument("--scans", type=int, default=12, help="number of scans of each")
    parser.add_argument("--no-crane", action="store_true", help="made people only")
    parser.add_argument(
        "--guide-degrees", type=float, help="do not adapt: use made people in perturbed poses as guides"
    )
    parser.add_argument("--no-learning", action="store_true", help="do not learn bodies from the meshes")
    parser.add_argument("--rounds", type=int, nargs="*", default=[3], help="rounds of vertices in each pass")
    parser.add_argument("--learning-rounds", type=int, default=4, help="largest number of learning rounds")
    parser.add_argument("--picture", type=Path, help="write PNGs of a few frames")
    options = parser.parse_args()
    template = jc.human(joints="tracking", resolution="medium")
    perturbed = options.guide_degrees is not None
    subjects = [make_person(number, options.scans) for number in range(options.people)]
    subjects += [] if options.no_crane or perturbed else [crane_subject(options.scans)]
    figures, limits = {}, {}
    for number, subject in enumerate(subjects):
        if perturbed:
            result = register_by_person(number, subject, options.guide_degrees)
        else:
            result = register(template, subject, tuple(options.rounds))
        if options.picture:
            draw(options.picture, subject, result)
        learning = None if options.no_learning else {"rounds": options.learning_rounds}
        row = measure(subject, result, learning)
        figures |= {f"{subject.name}_{key}": value for key, value in row.items()}
        limits |= {
            f"{subject.name}_surface_mm": ("<=", 1.5),
            f"{subject.name}_correspondence_mm": ("<=", 8.0),
            f"{subject.name}_failed": ("<=", 0.0),
        }
        if learning is not None:
            limits[f"{subject.name}_learned_ratio"] = ("<=", 1.3)
        # compiled functions of many shapes fill the memory maps of a process
        jax.clear_caches()
    sizes = {"scans": options.scans, "points": NOISE.points, "vertices": len(template.vertices)}
    finish("register", figures, limits, sizes)


if __name__ == "__main__":
    main()
