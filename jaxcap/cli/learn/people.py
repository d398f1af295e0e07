"""`jaxcap learn --people`: one body model from the meshes of several people."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...body.pose import Motion, concatenate_poses
from ...body.skeleton import KINDS, Skeleton
from ...errors import InputError
from ...fit.fit_meshes import fit_meshes
from ...io.archives.checkpoint import save_checkpoint
from ...io.body_models.learned import save_body_model
from ...io.skeletons.amass import write_amass
from ...io.system.run_lock import run_lock
from ...io.table import write_json
from ...learn.anatomy.joint_evidence import describe_joints, joint_evidence
from ...learn.learn_body import COARSE_PREFIX
from ...learn.parts.check_parts import check_learned
from ...learn.people.check_people import check_people, find_bent_joints, find_far_joints
from ...learn.people.learn_people import LearnedPeople, PeopleState, learn_people
from ...learn.people.rest_alignment import check_rest_alignment
from ...learn.people.shape_space import person_body
from ...observe.meshes import MeshSequence
from ...report.scores import Scores
from ..body_models import stated_gender
from ..console.console import pluralise, print_table, say, warn
from ..console.heartbeat import set_activity
from ..console.rounds import RoundProgress
from ..outputs import check_npz, check_parent, is_run_complete, make_folder
from ..scoring import mesh_hashes, score_motion
from .input import split_held_out
from .people_input import read_people
from .people_state import load_people_state, make_people_checkpoint
from .state import stop_message

#: components that a line lists
MAX_LISTED = 5


class PeopleRun(NamedTuple):
    """The options of a run: the files, and the arguments of `learn_people` with the settings that a report has."""

    meshes: Sequence[str]
    out: Path
    motion: Path | None
    report: Path | None
    unit: str
    rate: float | None
    hold_out: int | None
    resume: bool
    overwrite: bool
    learning: Mapping[str, Any]
    settings: Mapping[str, object]


def run_people(run: PeopleRun) -> None:
    """Learn one body model of several people, and write it with the parameters of each person."""
    set_activity("reading the meshes")
    people, names = read_people(run.meshes, run.unit, run.rate)
    paths = motion_paths(run.out, run.motion, tuple(people))
    for path in (run.out, *paths.values()):
        check_parent(path)
    kept = run.out.with_name(f"{run.out.name}.partial")
    with run_lock(run.out):
        # a run that was killed while it wrote its results resumes from its last round
        if run.resume and is_run_complete((run.out, *paths.values()), kept):
            return
        replace = run.overwrite or (run.resume and kept.is_file())
        check_npz(run.out, replace, "a body model")
        for path in paths.values():
            check_npz(path, replace)
        train, held = split_people(people, names, run.hold_out)
        for message in [
            *check_people(train[0], train[1]),
            *check_components(run.learning["components"], len(people)),
        ]:
            warn(message)
        header = {**run.settings, **people_hashes(train[0])}
        resumed = load_people_state(kept, header, run.resume, run.overwrite)
        if run.report is not None:
            make_folder(run.report)
        learned = learn_all(run, train[0], kept, header, resumed)
        set_activity("writing the body and checking it")
        write_all(run.out, paths, learned)
        describe(run, learned, paths)
        scores = score_people(learned, train, held)
        print_people(scores)
        if run.report is not None:
            write_report(run.report, run.settings, learned, scores)
        kept.unlink(missing_ok=True)


def check_people_options(given: Mapping[str, bool], components: int | None) -> None:
    """Check options with several people: those `given` by name are for one person. Raises `InputError`."""
    for name, present in given.items():
        if present:
            raise InputError(f"{name} is for the meshes of one person; leave it out.")
    if components is not None and components < 1:
        raise InputError(f"--components is {components}; it must be at least 1.")


def check_components(components: int | None, count: int) -> list[str]:
    """Return a sentence if more coefficients are asked for than several people can have."""
    if components is None or components < count:
        return []
    return [
        f"--components is {components}, and {count} people have {count - 1} at most; give meshes of more people for more"
    ]


def check_people_skeleton(file: str, skeleton: Skeleton) -> None:
    """Check that motions of a skeleton can be written in AMASS's format: one root, and no other joint that moves along an axis.

    **Raises:** `InputError`.
    """
    roots = [name for name, parent in zip(skeleton.names, skeleton.parents, strict=True) if parent < 0]
    moving = [
        name
        for name, kind, parent in zip(skeleton.names, skeleton.kinds, skeleton.parents, strict=True)
        if parent >= 0 and KINDS[kind][0]
    ]
    found = f"{len(roots)} roots, {', '.join(roots)}" if len(roots) > 1 else None
    found = f"joints that are translated, {', '.join(moving)}" if moving else found
    if found:
        raise InputError(
            f"{file}: this skeleton has {found}, and the poses of several people are written in AMASS's format, which has one root and "
            "rotations of the other joints; give another skeleton, or learn each person without --people."
        )


def motion_paths(out: Path, motion: Path | None, names: Sequence[str]) -> dict[str, Path]:
    """Name the file of each person's parameters: `model-motion-anna.npz` for `model.npz` and anna."""
    base = out.with_name(f"{out.stem}-motion.npz") if motion is None else motion
    return {name: base.with_name(f"{base.stem}-{name}{base.suffix}") for name in names}


#: meshes of each person, and their names
Meshes = tuple[dict[str, MeshSequence], dict[str, tuple[str, ...]]]


def split_people(
    people: Mapping[str, MeshSequence], names: Mapping[str, tuple[str, ...]], hold_out: int | None
) -> tuple[Meshes, Meshes]:
    """Split the meshes of each person into training and held-out ones. Raises `InputError` if none is held out."""
    train: Meshes = ({}, {})
    held: Meshes = ({}, {})
    for name, meshes in people.items():
        for (sequences, called), rows in zip(
            (train, held), split_held_out(len(meshes), hold_out), strict=True
        ):
            if len(rows):
                sequences[name], called[name] = meshes[rows], tuple(names[name][row] for row in rows)
    if hold_out is not None and not held[0]:
        raise InputError(f"--hold-out {hold_out} leaves out no mesh of any person; give a lower number.")
    return train, held


def people_hashes(people: Mapping[str, MeshSequence]) -> dict[str, object]:
    """Compute the hash of the meshes of all people, to detect changes."""
    hashes = {name: mesh_hashes(meshes) for name, meshes in people.items()}
    whole = hashlib.sha256(json.dumps(hashes).encode()).hexdigest()
    return {"meshes": whole, "precision": next(iter(hashes.values()))["precision"]}


def learn_all(
    run: PeopleRun,
    people: Mapping[str, MeshSequence],
    kept: Path,
    header: Mapping[str, object],
    resumed: PeopleState | None,
) -> LearnedPeople:
    """Run the learning loop with its progress, and a checkpoint after every round; Ctrl-C keeps the last one."""
    done = 0 if resumed is None else resumed.round
    rate = next(iter(people.values())).rate
    count = sum(len(meshes) for meshes in people.values())
    vertices = next(iter(people.values())).vertices.shape[1]
    say(
        f"learning one body from {pluralise(len(people), 'person', 'people')}, {count} meshes of {vertices} vertices; "
        + (f"round {done} is complete" if done else "a first body is learned from one person")
    )
    with RoundProgress(run.learning["rounds"], done) as bar:

        def on_round(state: PeopleState) -> None:
            nonlocal done
            save_checkpoint(kept, make_people_checkpoint(state, rate), header)
            done = state.round
            step, value = state.history[-1]
            some = (
                f" on {len(state.people[0].body.vertices)} vertices" if step.startswith(COARSE_PREFIX) else ""
            )
            bar.update(done, f"Q {value:.5g} m²{some}")

        try:
            return learn_people(people, on_round=on_round, resume=resumed, **run.learning)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(stop_message(done, kept)) from None


def write_all(out: Path, paths: Mapping[str, Path], learned: LearnedPeople) -> None:
    """Write the model, and the coefficients and poses of each person in AMASS's format."""
    save_body_model(out, learned.model, dict(zip(learned.names, learned.coefficients, strict=True)))
    gender = stated_gender(str(out)) or "neutral"
    for name, row, motion in zip(learned.names, learned.coefficients, learned.motions, strict=True):
        body = person_body(learned.model, row)
        write_amass(paths[name], body.skeleton, motion, {learned.model.groups[0][0]: row}, gender, up="y")


def describe(run: PeopleRun, learned: LearnedPeople, paths: Mapping[str, Path]) -> None:
    """Print the size of the model, its joints and the variance of its components, and messages about the joints."""
    body = learned.model.template
    joints = sum(parent >= 0 for parent in body.skeleton.parents)
    say(
        f"{run.out}: {len(body.vertices)} vertices on {body.skeleton.num_joints} bones with {joints} joints between them; poses and "
        f"coefficients in {next(iter(paths.values()))}" + (" and so on" if len(paths) > 1 else "")
    )
    shares = learned.explained
    listed = ", ".join(f"{100 * share:.1f}" for share in shares[:MAX_LISTED])
    say(
        f"{pluralise(len(shares), 'coefficient')} explain {100 * shares.sum():.1f} % of the variance of "
        f"{pluralise(len(learned.names), 'person', 'people')} at rest; the first {len(shares[:MAX_LISTED])}: {listed} %"
    )
    motion = Motion(concatenate_poses([motion.poses for motion in learned.motions]), learned.motions[0].rate)
    evidence = joint_evidence(body.skeleton, motion, learned.left_right_pairs, learned.given)
    if learned.symmetry_message:
        say(learned.symmetry_message)
    say("joints of the mean of the people, and their rotations over all meshes:")
    for line in describe_joints(evidence, learned.given is not None):
        say(line)
    if not len(learned.left_right_pairs):
        say("no left and right joints were paired")
    doubts = [
        *find_bent_joints(body.skeleton, learned.motions, learned.names),
        *find_far_joints(learned.model, learned.coefficients, learned.names),
    ]
    for message in [*check_rest_alignment(body.skeleton), *check_learned(body, motion), *doubts]:
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
