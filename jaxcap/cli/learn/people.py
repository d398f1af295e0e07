"""`jaxcap learn --people`: one body model from the meshes of several people."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.body_model import BodyModel, shape_body
from ...body.pose import Motion, concatenate_poses
from ...errors import InputError
from ...fit.fit_meshes import fit_meshes
from ...io.body_models.learned import save_body_model
from ...io.skeletons.amass import write_amass
from ...io.system.run_lock import run_lock
from ...io.table import write_json
from ...learn.anatomy.joint_evidence import describe_joints, joint_evidence
from ...learn.learn_body import COARSE_PREFIX
from ...learn.parts.check_parts import check_learned
from ...learn.people.check_people import check_people
from ...learn.people.learn_people import LearnedPeople, PeopleState, learn_people
from ...observe.meshes import MeshSequence
from ...report.scores import Scores
from ..console.console import pluralise, print_table, say, warn
from ..console.heartbeat import set_activity
from ..console.rounds import RoundProgress
from ..motions import load_skeleton
from ..outputs import check_npz, check_parent, make_folder
from ..scoring import score_motion
from .input import read_pairs, split_held_out
from .people_input import read_people

if TYPE_CHECKING:
    from .learn import Learn

#: components that a line lists
MAX_LISTED = 5


def run_people(options: "Learn") -> None:
    """Learn one body model of several people, and write it with the parameters of each person."""
    check_options(options)
    set_activity("reading the meshes")
    people, names = read_people(options.meshes, options.unit, options.rate)
    paths = motion_paths(options.out, options.motion, tuple(people))
    for path in (options.out, *paths.values()):
        check_parent(path)
    with run_lock(options.out):
        check_npz(options.out, options.overwrite, "a body model")
        for path in paths.values():
            check_npz(path, options.overwrite)
        train, held = split_people(people, names, options.hold_out)
        for message in check_people(train[0], train[1]):
            warn(message)
        if options.report is not None:
            make_folder(options.report)
        learned = learn_all(options, train[0])
        set_activity("writing the body and checking it")
        write_all(options.out, paths, learned)
        describe(options, learned, paths)
        scores = score_people(learned, train, held)
        print_people(scores)
        if options.report is not None:
            write_report(options.report, options.settings(), learned, scores)


def check_options(options: "Learn") -> None:
    """Check that options are compatible with several people. Raises `InputError`."""
    others = {
        "--resume": options.resume,
        "--free-bones": options.free_bones,
        "--limits": options.limits is not None,
        "--floor": options.floor is not None,
    }
    for name, given in others.items():
        if given:
            raise InputError(f"{name} is for the meshes of one person; leave it out.")
    if options.components is not None and options.components < 1:
        raise InputError(f"--components is {options.components}; it must be at least 1.")


def motion_paths(out: Path, motion: Path | None, names: Sequence[str]) -> dict[str, Path]:
    """Name the file of each person's parameters: `model-motion-anna.npz` for `model.npz` and anna."""
    base = out.with_name(f"{out.stem}-motion.npz") if motion is None else motion
    return {name: base.with_name(f"{base.stem}-{name}{base.suffix}") for name in names}


#: meshes of each person, and their names
Meshes = tuple[dict[str, MeshSequence], dict[str, tuple[str, ...]]]


def split_people(
    people: Mapping[str, MeshSequence], names: Mapping[str, Sequence[str]], hold_out: int | None
) -> tuple[Meshes, Meshes]:
    """Split the meshes of each person into training and held-out ones. Raises `InputError` if none is held out."""
    groups: tuple[Meshes, Meshes] = (({}, {}), ({}, {}))
    for name, meshes in people.items():
        for (sequences, called), rows in zip(groups, split_held_out(len(meshes), hold_out), strict=True):
            if len(rows):
                sequences[name], called[name] = meshes[rows], tuple(names[name][row] for row in rows)
    if hold_out is not None and not groups[1][0]:
        raise InputError(f"--hold-out {hold_out} leaves out no mesh of any person; give a lower number.")
    return groups


def learn_all(options: "Learn", people: Mapping[str, MeshSequence]) -> LearnedPeople:
    """Run the learning loop with its progress."""
    file, name = options.skeleton_file(), options.skeleton_name()
    skeleton = name if file is None else load_skeleton(file, options.unit)
    given = None if isinstance(skeleton, str) else skeleton
    count = sum(len(meshes) for meshes in people.values())
    vertices = next(iter(people.values())).vertices.shape[1]
    say(
        f"learning one body from {pluralise(len(people), 'person', 'people')}, {count} meshes of {vertices} vertices; a first body is "
        "learned from one person"
    )
    with RoundProgress(options.rounds) as bar:

        def on_round(state: PeopleState) -> None:
            step, value = state.history[-1]
            some = (
                f" on {len(state.people[0].body.vertices)} vertices" if step.startswith(COARSE_PREFIX) else ""
            )
            bar.update(state.round, f"Q {value:.5g} m²{some}")

        return learn_people(
            people,
            components=options.components,
            joints=options.joints,
            skin=options.skin,
            alpha=options.alpha,
            symmetry=options.symmetry if options.pairs is None else read_pairs(options.pairs, given),
            skeleton=skeleton,
            fix_joints=options.fix_joints,
            rounds=options.rounds,
            on_round=on_round,
        )


def write_all(out: Path, paths: Mapping[str, Path], learned: LearnedPeople) -> None:
    """Write the model, and the coefficients and poses of each person in AMASS's format."""
    save_body_model(out, learned.model, dict(zip(learned.names, learned.coefficients, strict=True)))
    for name, row, motion in zip(learned.names, learned.coefficients, learned.motions, strict=True):
        body = person_body(learned.model, row)
        write_amass(paths[name], body.skeleton, motion, {learned.model.groups[0][0]: row}, up="y")


def person_body(model: BodyModel, coefficients: np.ndarray) -> Body:
    """Make the body of a person from the coefficients."""
    return shape_body(model, jnp.asarray(coefficients, model.template_coefficients.dtype))


def describe(options: "Learn", learned: LearnedPeople, paths: Mapping[str, Path]) -> None:
    """Print the size of the model, its joints and the variance of its components, and messages about the joints."""
    body = learned.model.template
    joints = sum(parent >= 0 for parent in body.skeleton.parents)
    say(
        f"{options.out}: {len(body.vertices)} vertices on {body.skeleton.num_joints} bones with {joints} joints between them; poses and "
        f"coefficients in {next(iter(paths.values()))}" + (" and so on" if len(paths) > 1 else "")
    )
    shares = learned.explained
    listed = ", ".join(f"{100 * share:.1f}" for share in shares[:MAX_LISTED])
    say(
        f"{pluralise(len(shares), 'coefficient')} explain {100 * shares.sum():.1f} % of the variance of "
        f"{pluralise(len(learned.names), 'person', 'people')} at rest; the first {len(shares[:MAX_LISTED])}: {listed} %"
    )
    asked = options.components
    if asked is not None and asked > len(shares):
        warn(
            f"--components is {asked}, and {len(learned.names)} people have {len(shares)} at most; give meshes of more people for more"
        )
    motion = Motion(concatenate_poses([motion.poses for motion in learned.motions]), learned.motions[0].rate)
    evidence = joint_evidence(body.skeleton, motion, learned.left_right_pairs, learned.given)
    say("joints of the mean of the people, and their rotations over all meshes:")
    for line in describe_joints(evidence, learned.given is not None):
        say(line)
    if not len(learned.left_right_pairs):
        say("no left and right joints were paired")
    for message in check_learned(body, motion):
        warn(message)


def score_people(learned: LearnedPeople, train: Meshes, held: Meshes) -> dict[str, dict[str, Scores]]:
    """Score each person's body, of the coefficients, on the training and the held-out meshes."""
    found: dict[str, dict[str, Scores]] = {}
    for name, row, motion in zip(learned.names, learned.coefficients, learned.motions, strict=True):
        body = person_body(learned.model, row)
        groups = {"training": (train[0][name], train[1][name], motion, np.ones(len(motion), bool))}
        if name in held[0]:
            set_activity(f"fitting the held-out meshes of {name}")
            fit = fit_meshes(body, held[0][name])
            groups["held out"] = (held[0][name], held[1][name], fit.motion, np.asarray(fit.converged))
        found[name] = {
            label: score_motion(body, poses, fitted, meshes, called, f"scoring {name}, {label}")
            for label, (meshes, called, poses, fitted) in groups.items()
        }
    return found


def print_people(scores: Mapping[str, Mapping[str, Scores]]) -> None:
    """Print a table of the errors of each person, and of their means."""
    held = any("held out" in each for each in scores.values())
    labels = ["training", *(["held out"] if held else [])]
    rows = []
    for name, each in scores.items():
        cells = [value for label in labels for value in _cells(each.get(label))]
        rows.append([name, str(len(each["training"].meshes)), *cells])
    means = [
        f"{1000 * np.mean([getattr(each[label], kind) for each in scores.values() if label in each]):.2f}"
        for label in labels
        for kind in ("mean", "rmse")
    ]
    rows.append([f"mean of {len(scores)} people", "", *means])
    head = [f"{label}: {kind}" if held else kind for label in labels for kind in ("surface", "vertex RMSE")]
    print_table(["person, errors in mm", "meshes", *head], rows)


def _cells(scores: Scores | None) -> list[str]:
    if scores is None:
        return ["-", "-"]
    return [f"{1000 * value:.2f}" for value in (scores.mean, scores.rmse)]


def write_report(
    folder: Path,
    settings: Mapping[str, object],
    learned: LearnedPeople,
    scores: Mapping[str, Mapping[str, Scores]],
) -> None:
    """Write report.json with the components, the coefficients and the errors of each person."""
    skeleton = learned.model.template.skeleton
    write_json(
        folder / "report.json",
        {
            "settings": dict(settings),
            "joints": {
                "names": list(skeleton.names),
                "parents": list(skeleton.parents),
                "centres": np.asarray(skeleton.centres, float).tolist(),
            },
            "explained": learned.explained.tolist(),
            "history": [{"step": step, "Q": value} for step, value in learned.history],
            "people": {
                name: {
                    "coefficients": row.tolist(),
                    **{label: each.report() for label, each in scores[name].items()},
                }
                for name, row in zip(learned.names, learned.coefficients, strict=True)
            },
        },
    )
    say(f"report.json is in {folder}")
