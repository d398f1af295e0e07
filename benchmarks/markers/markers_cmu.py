"""Fit a person to CMU's 41 markers and compare the joints with the database's: `python -m benchmarks.markers_cmu`.

Take 02_05, punches and strikes: raw markers, and the database's own skeleton and motion of the same frames.

- By default `fit_human` gets the markers with the laboratory's labels. With `--hidden` markers are shuffled and
  have numbers as labels, so that landmarks are recognised by geometry. Joints of the same name are compared.
- `--technique local` finds segments and a tree of bones, of shuffled markers without labels. Each bone found is one of the
  database's (`_cmu_tree.py`).
- Distances of joints are before and after the best constant offset in the frame of the joint's parent, as the
  database puts its centres elsewhere in its bones.
- The residual of the markers, with that of the database's skeleton, each marker on the bone that
  carries it best. How much the distances of a joint from the markers on both its bones change is the least error
  that joints fixed in bones can have; it is measured for the database's joints and for ours.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.markers._cmu_tree import compare_tree
from benchmarks.markers._database_joints import (
    DatabaseMotion,
    JointError,
    bone_frames,
    bone_residuals,
    joint_error,
    load_database,
)
from benchmarks.report import Timer, finish, progress
from jaxcap.markers.subject import Subject
from jaxcap.observe.markers import MarkerFrames

TAKE = "02_05"
#: the database's x, y, z are the markers' y, z, x
AXES = [1, 2, 0]
#: joints of the left side and the middle, and the database's bones that start there. Its forearm ends after 190 mm, and its wrist
#: after 284 mm: the end of the latter is nearer to the markers of the wrist
JOINTS = {
    "LeftUpLeg": "lfemur", "LeftLeg": "ltibia", "LeftFoot": "lfoot", "LeftArm": "lhumerus", "LeftForeArm": "lradius",
    "LeftHand": "lhand", "Neck": "upperneck",
}  # fmt: skip
#: largest distances of joints of a person before and after the best offset, and of a found tree after it, millimetres
MAX_BEFORE, MAX_AFTER, MAX_TREE_AFTER = 25.0, 12.0, 15.0


class Fitted(NamedTuple):
    """A subject and its motion through the take."""

    subject: Subject
    motion: jc.Motion
    residuals: Float[np.ndarray, "F M"]
    lost: np.ndarray
    messages: Sequence[str]


def in_database_axes(frames: MarkerFrames, seed: int | None) -> tuple[MarkerFrames, tuple[str, ...]]:
    """Rotate markers to the database's axes; with a seed, permute them with numbers as labels. Also return the labels."""
    places, seen = np.asarray(frames.positions)[..., AXES], np.asarray(frames.visible)
    if seed is None:
        return MarkerFrames(places, seen, frames.labels, frames.rate), frames.labels
    order = np.random.default_rng(seed).permutation(len(frames.labels))
    names = tuple(f"point{i}" for i in range(len(order)))
    called = tuple(frames.labels[i] for i in order)
    return MarkerFrames(places[:, order], seen[:, order], names, frames.rate), called


def fit_person(frames: MarkerFrames, called: Sequence[str], is_hidden: bool, timer: Timer) -> Fitted:
    """Fit the human as the library does by default."""
    known = None
    if is_hidden:
        found = timer(jc.markers.recognise_by_geometry, frames)
        known = found.marker_set
        names = [f"{label} {name}" for label, name in zip(called, known.names, strict=True)]
        progress(f"landmarks by geometry: {', '.join(names)}")
    fit = timer(jc.markers.fit_human, frames, marker_set=known)
    return Fitted(fit.subject, fit.motion, fit.residuals, fit.lost, fit.messages)


def fit_tree(frames: MarkerFrames, called: Sequence[str], only_local: bool, timer: Timer) -> Fitted:
    """Find a tree of bones, and fit all unknowns together unless `only_local`."""
    found = timer(jc.markers.fit_local, frames)
    for name, members in zip(found.segments.names, found.segments.members, strict=True):
        progress(f"{name}: {', '.join(called[int(m)] for m in members)}")
    calibrated = None if only_local else timer(jc.markers.calibrate, found.markers, found.subject)
    subject = found.subject if calibrated is None else calibrated.subject
    solution = timer(jc.markers.solve_markers, subject, frames)
    messages = (*found.messages, *(() if calibrated is None else calibrated.messages), *solution.messages)
    return Fitted(subject, solution.motion, solution.residuals, solution.lost, messages)


def compare_person(
    database: DatabaseMotion,
    fit: Fitted,
    ours: Float[np.ndarray, "F J 3"],
    places: Float[np.ndarray, "F M 3"],
) -> tuple[list[JointError], dict[str, float]]:
    """Compare joints by their names; also compute how much distances from markers change, of their joints and of ours."""
    skeleton, found, changes = fit.subject.skeleton, [], []
    pairs = dict(JOINTS)
    for name, other in JOINTS.items():
        if name.startswith("Left"):
            pairs[name.replace("Left", "Right")] = "r" + other[1:]
    bones = np.asarray(fit.subject.bones)
    for name, other in pairs.items():
        mine, theirs = skeleton.index(name), database.skeleton.index(other)
        found.append(joint_error(database, name, theirs, ours[:, mine]))
        near = np.flatnonzero(np.isin(bones, [mine, skeleton.parents[mine]]))
        changes.append(
            [
                distance_change(joint, places[:, near])
                for joint in (database.centres[:, theirs], ours[:, mine])
            ]
        )
    theirs, mine = 1e3 * np.nanmean(changes, axis=0)
    return found, {"database_joint_to_marker_change_mm": theirs, "joint_to_marker_change_mm": mine}


def distance_change(joint: Float[np.ndarray, "F 3"], places: Float[np.ndarray, "F N 3"]) -> float:
    """Compute the mean absolute deviation of the distances of a joint from markers, mean over these, metres."""
    lengths = np.linalg.norm(places - joint[:, None], axis=2)
    usual = np.nanmedian(lengths, axis=0)
    return float(np.nanmean(np.abs(lengths - usual))) if lengths.size else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_cmu", description="Fit a skeleton to CMU's 41 markers."
    )
    parser.add_argument(
        "--technique",
        choices=("human", "local"),
        default="human",
        help="human: the human's skeleton; local: segments and joints are found",
    )
    parser.add_argument("--hidden", action="store_true", help="hide the labels (local: always)")
    parser.add_argument("--frames", type=int, help="number of frames to use")
    parser.add_argument("--every", type=int, default=1, help="use each n-th frame only")
    parser.add_argument(
        "--local", action="store_true", help="with --technique local: do not fit all unknowns together"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the random order of markers")
    parser.add_argument("--picture", type=Path, help="write a PNG of the skeleton and its markers")
    options = parser.parse_args()
    shared, is_person = shared_folder(), options.technique == "human"
    chosen, is_hidden = slice(None, options.frames, options.every), options.hidden or not is_person
    read = jc.read_markers(shared / "data" / "markers" / f"cmu_{TAKE}.c3d")[chosen]
    frames, called = in_database_axes(read, options.seed if is_hidden else None)
    database, timer = load_database(shared, TAKE, chosen), Timer()
    if is_person:
        fit = fit_person(frames, called, is_hidden, timer)
    else:
        fit = fit_tree(frames, called, options.local, timer)
    for sentence in fit.messages:
        progress(f"message: {sentence}")

    subject, labels = fit.subject, frames.labels
    seen, places = (
        np.asarray(frames.visible),
        np.where(np.asarray(frames.visible)[..., None], frames.positions, np.nan),
    )
    best, squares = bone_residuals(database, places, seen)
    _, _, ours = bone_frames(subject.skeleton, fit.motion)
    columns = np.array([labels.index(label) for label in subject.labels])
    figures: dict[str, Any] = {}
    if is_person:
        joints, changes = compare_person(database, fit, ours, places[:, columns])
        figures |= changes
    else:
        # bones of the subject's markers, in its order
        joints, figures["edges_wrong"] = compare_tree(database, squares[columns], subject, ours)
    for joint in joints:
        progress(
            f"{joint.name}: {1e3 * joint.after:.1f} mm after the offset, {1e3 * joint.before:.1f} mm before"
        )
    with_weight = np.asarray(subject.weights) > 0
    figures |= {
        "joints_mm": 1e3 * float(np.mean([joint.after for joint in joints])),
        "joints_before_mm": 1e3 * float(np.mean([joint.before for joint in joints])),
        "joints": len(joints),
        "markers_with_weight": int(with_weight.sum()),
        "residual_mm": 1e3 * float(np.sqrt(np.nanmean(fit.residuals[:, with_weight] ** 2))),
        "database_residual_mm": 1e3 * float(np.sqrt(np.nanmean(best[:, columns[with_weight]] ** 2))),
        "lost": int(fit.lost.sum()),
        "database_each_mm": dict(zip(called, 1e3 * np.sqrt(np.nanmean(best**2, 0)), strict=True)),
        "joints_each_mm": {joint.name: (1e3 * joint.before, 1e3 * joint.after) for joint in joints},
    }
    figures["residual_share"] = figures["residual_mm"] / figures["database_residual_mm"]
    limits = {"joints_mm": ("<=", MAX_AFTER if is_person else MAX_TREE_AFTER), "residual_share": ("<=", 1.0)}
    if is_person:
        limits["joints_before_mm"] = ("<=", MAX_BEFORE)
    if options.picture:
        from jaxcap.report.markers.marker_pictures import draw_skeleton

        matched = MarkerFrames(frames.positions[:, columns], seen[:, columns], subject.labels, frames.rate)
        draw_skeleton(options.picture, subject, fit.motion, matched, fit.residuals, f"CMU {TAKE}")
        progress(f"picture: {options.picture}")
    sizes = {"frames": len(frames), "markers": len(labels), "bones": subject.skeleton.num_joints}
    finish("markers_cmu", figures, limits, sizes, timer.seconds)


if __name__ == "__main__":
    main()
