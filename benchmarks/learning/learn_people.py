"""Learn one body of several people and measure it on other poses and other people: `python -m benchmarks.learn_people`.

    python -m benchmarks.learn_people --people 8 --meshes 8 --seed 0

People of random builds, made from the embedded human under swing-twist skinning, their vertices in one random order, are posed by
CMU's motions, each in poses of its own. One body model is learned from all with default options. Errors are those

- of each person's body in poses that were not learned from,
- of the model fitted to people who were not learned from, with their coefficients as unknowns,
- of joints in the training poses against the made people's.

A shape space of N people has N - 1 components. How well any linear shape space of these people could represent the other people is
computed from the true rest shapes (`bound_mm`, without poses).
"""

import argparse
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import (
    Clock,
    meshes_of,
    named_joint_errors,
    posed_vertices,
    select_frames,
    surface_distances,
    varied_motion,
    vertex_errors_mm,
    without_cache,
)
from benchmarks.learning.learn_anatomy import HINGES, MAJOR, part_of
from benchmarks.report import finish, progress
from jaxcap.body.people.random_humans import sample_humans
from jaxcap.body.skin import swing_twist_from
from jaxcap.fit.fit_meshes import fit_meshes
from jaxcap.fit.fit_model import fit_model
from jaxcap.learn.anatomy.joint_evidence import joint_evidence
from jaxcap.learn.people.learn_people import LearnedPeople, learn_people
from jaxcap.learn.people.shape_space import make_shape_space
from jaxcap.observe.meshes import MeshSequence
from jaxcap.report.weights import skeleton_picture

#: dissimilar poses from which those of each person are drawn
POSES = 160
#: meshes of a person in other poses than those of learning
OTHER_POSES = 4
#: coefficients of a fit to other people
COEFFICIENTS = 10


class MadePerson(NamedTuple):
    """A made person, and its poses for learning and for the test."""

    body: jc.Body
    training: jc.Motion
    others: jc.Motion


def make_people(count: int, meshes: int, seed: int, resolution: str, single: int = 0) -> list[MadePerson]:
    """Make people of random builds, each in random poses of one subject; `single` people after the first have a single mesh."""
    rng = np.random.default_rng(seed)
    template = jc.human(resolution="low")
    motion = varied_motion(shared_folder(), template, POSES)
    order, people = None, []
    for body in sample_humans(count, seed=seed, resolution=resolution, joints="tracking"):
        order = rng.permutation(len(body.vertices)) if order is None else order
        faces = np.argsort(order).astype(np.int32)[np.asarray(body.faces)]
        skin = swing_twist_from(body.skin, body.skeleton).take(order)
        body = jc.Body(body.skeleton, skin, body.vertices[order], faces)
        some = rng.choice(len(motion), meshes + OTHER_POSES, replace=False)
        moved = jc.retarget(select_frames(motion, some), template.skeleton, body.skeleton)
        frames, own = np.arange(len(some)), 1 if 0 < len(people) <= single else meshes
        people.append(
            MadePerson(body, select_frames(moved, frames[:own]), select_frames(moved, frames[meshes:]))
        )
    return people


def learn_from(people: list[MadePerson], rounds: int | None) -> tuple[LearnedPeople, float]:
    """Learn with default options; return also the seconds."""
    given = {
        f"person{number}": meshes_of(person.body, person.training) for number, person in enumerate(people)
    }
    clock = Clock()

    def on_round(state) -> None:
        progress(f"  round {state.round}: Q {state.history[-1][1]:.5g} m², {clock.elapsed:.0f} s")

    with clock:
        learned = learn_people(
            given,
            components=min(COEFFICIENTS, len(people) - 1),
            on_round=on_round,
            **({} if rounds is None else {"rounds": rounds}),
        )
    return learned, clock.total


def errors_of(
    body: jc.Body, motion: jc.Motion, meshes: MeshSequence
) -> tuple[Float[np.ndarray, "F V"], Float[np.ndarray, "F V"]]:
    """Measure the distances of vertices from the surface, and from their own positions, millimetres."""
    posed = posed_vertices(body, motion)
    return surface_distances(meshes, posed), vertex_errors_mm(posed, meshes.vertices)


def own_figures(people: list[MadePerson], learned: LearnedPeople) -> dict[str, float]:
    """Measure the bodies of the people of learning: surfaces in other poses, joints, and lengths left and right."""
    surface, vertex, training, parts, lengths = [], [], [], {}, 0.0
    for person, row, motion in zip(people, learned.coefficients, learned.motions, strict=True):
        body = jc.shape_body(learned.model, row.astype(np.float32))
        training.append(errors_of(body, motion, meshes_of(person.body, person.training))[0].mean())
        others = meshes_of(person.body, person.others)
        for errors, some in zip(
            errors_of(body, fit_meshes(body, others).motion, others), (surface, vertex), strict=True
        ):
            some.append(errors.mean())
        evidence = joint_evidence(body.skeleton, motion, learned.left_right_pairs)
        lengths = max(lengths, evidence.largest_length_difference)
        found = named_joint_errors(person.body, person.training, body, motion, MAJOR)
        for name, centre, off in zip(found.names, found.centres, found.determined, strict=True):
            part = part_of(name)
            parts.setdefault(part, []).append(off if part in HINGES else centre)
        listed = ", ".join(f"{n} {e:.0f}" for n, e in zip(found.names, found.determined, strict=True))
        progress(
            f"  training {training[-1]:.2f} mm, other poses {surface[-1]:.2f} mm (vertices {vertex[-1]:.2f}); joints: {listed}"
        )
    return {
        "training_surface_mm": float(np.mean(training)),
        "poses_surface_mm": float(np.mean(surface)),
        "worst_poses_surface_mm": float(np.max(surface)),
        "poses_vertex_mm": float(np.mean(vertex)),
        **{f"{part}_mm": float(np.mean(errors)) for part, errors in parts.items()},
        **{f"worst_{part}_mm": float(np.max(errors)) for part, errors in parts.items()},
        "left_right_percent": 100 * lengths,
    }


def other_figures(people: list[MadePerson], learned: LearnedPeople) -> dict[str, float]:
    """Measure the model on people who were not learned from."""
    surface, vertex = [], []
    for person in people:
        meshes = meshes_of(person.body, person.training)
        fit = fit_model(learned.model, meshes)
        errors = errors_of(jc.shape_body(learned.model, fit.coefficients[0]), fit.motion, meshes)
        for each, some in zip(errors, (surface, vertex), strict=True):
            some.append(each.mean())
        progress(f"  another person: {surface[-1]:.2f} mm (vertices {vertex[-1]:.2f})")
    return {
        "people_surface_mm": float(np.mean(surface)),
        "worst_people_surface_mm": float(np.max(surface)),
        "people_vertex_mm": float(np.mean(vertex)),
    }


def bound(people: list[MadePerson], others: list[MadePerson]) -> float:
    """Compute the mean error of vertices at rest of other people in the principal components of the true people, millimetres."""
    space = make_shape_space([person.body for person in people], min(COEFFICIENTS, len(people) - 1)).model
    modes = np.asarray(space.modes.vertices, float).reshape(len(space.template_coefficients), -1).T
    errors = []
    for person in others:
        # position does not count
        columns = np.concatenate([modes, np.tile(np.eye(3), (len(person.body.vertices), 1))], 1)
        shift = np.asarray(person.body.vertices - space.template.vertices, float).ravel()
        left = shift - columns @ np.linalg.lstsq(columns, shift)[0]
        errors.append(1000 * np.linalg.norm(left.reshape(-1, 3), axis=1).mean())
    return float(np.mean(errors))


def run(count: int, options) -> dict[str, float]:
    """Learn from a number of people, and measure."""
    progress(f"{count} people, seed {options.seed}")
    made = make_people(
        count + options.others, options.meshes, options.seed, options.resolution, options.single
    )
    own, others = made[:count], made[count:]
    learned, seconds = learn_from(own, options.rounds)
    if options.pictures:
        skeleton_picture(f"{options.pictures}-{count}.png", learned.model.template, learned.given)
    found = own_figures(own, learned) | other_figures(others, learned) | {"seconds": seconds}
    found["bound_mm"] = bound(own, others)
    jax.clear_caches()
    progress(f"  {found}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_people", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--people", type=int, default=8, help="number of people who are learned from")
    parser.add_argument("--more", type=int, default=24, help="the same in a second run; 0 for none")
    parser.add_argument("--others", type=int, default=8, help="number of other people")
    parser.add_argument("--meshes", type=int, default=8, help="number of meshes of each person")
    parser.add_argument(
        "--single", type=int, default=0, help="number of people with a single mesh, of those after the first"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of builds and poses")
    parser.add_argument("--resolution", choices=("full", "medium", "low"), default="low")
    parser.add_argument("--rounds", type=int, help="maximum number of learning rounds")
    parser.add_argument("--pictures", help="beginning of the names of pictures of the skeletons")
    options = parser.parse_args()
    if options.single >= options.people:
        parser.error(f"--single {options.single}: give fewer than --people {options.people}")
    without_cache()
    figures = run(options.people, options)
    limits = {
        "poses_surface_mm": ("<=", 1.0),
        "hip_mm": ("<=", 20.0),
        "shoulder_mm": ("<=", 20.0),
        "knee_mm": ("<=", 12.0),
        "elbow_mm": ("<=", 12.0),
        "left_right_percent": ("<=", 1.5),
    }
    if options.more:
        figures |= {f"more_{name}": value for name, value in run(options.more, options).items()}
        limits |= {"more_poses_surface_mm": ("<=", 1.0), "more_people_surface_mm": ("<=", 2.0)}
    sizes = {
        name: getattr(options, name) for name in ("people", "more", "others", "meshes", "single", "seed")
    }
    finish("learn_people", figures, limits, sizes)


if __name__ == "__main__":
    main()
