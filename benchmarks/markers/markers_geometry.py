"""Recognise landmarks of unlabelled markers by their geometry: `python -m benchmarks.markers.markers_geometry`.

Builds of the embedded human wear the marker sets of eight laboratories, 6 mm from their landmarks along each axis, those
on plates 30 mm. They stand for a moment with their arms at one of four angles, and walk. Labels are numbers. A set is right if every
marker that gets a landmark is on its bone and side; refusals are counted by themselves.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks.markers._laboratories import LABORATORIES
from benchmarks.report import finish, progress
from jaxcap.body.people.morph_targets import Traits
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.marker_sets.landmarks import landmarks
from jaxcap.markers.marker_sets.recognise import recognise_markers
from jaxcap.markers.recognition.all_landmarks import all_landmarks
from jaxcap.markers.subject import Subject, marker_positions
from jaxcap.observe.markers import MarkerFrames

#: angles of the arms at the sides, radians, and number of frames
ARMS, FRAMES = (-0.7, 0.5, -0.3, 0.0), 40
#: standard deviations of placements, metres: on landmarks, and on plates or somewhere on a segment; noise
PLACING, PLACING_LOOSE, NOISE = 0.006, 0.03, 0.001

_all_places = eqx.filter_jit(
    lambda subject, poses: jax.lax.map(lambda p: marker_positions(subject, p), poses)
)


def walking_person(seed: int) -> tuple[Subject, jc.Pose]:
    """Draw a person with all landmarks as markers, who stands for a moment and walks."""
    rng = np.random.default_rng(seed)
    weight, muscle = np.clip(rng.normal(0.5, 0.2, 2), 0, 1)
    traits = Traits(float(seed % 2), rng.uniform(18, 75), weight, muscle, float(np.clip(rng.normal(0, 0.15), -1, 1)))  # fmt: skip
    subject = make_human_template(all_landmarks(), Traits(*map(float, traits))).subject
    skeleton, facing, arm = subject.skeleton, rng.uniform(0, 2 * np.pi), ARMS[seed % len(ARMS)]
    poses = []
    for frame in range(FRAMES):
        share, swing = np.clip((frame - 5) / 10, 0, 1), np.sin(0.3 * frame)
        bent = 1 - np.cos(0.3 * frame)
        angles = {
            "LeftArm": (-0.4 * share * swing, 0, arm), "RightArm": (0.4 * share * swing, 0, -arm),
            "LeftForeArm": (-0.3 - 0.3 * share * (1 + swing), 0, 0), "RightForeArm": (-0.3 - 0.3 * share * (1 - swing), 0, 0),
            "LeftUpLeg": (0.5 * share * swing, 0, 0.05), "RightUpLeg": (-0.5 * share * swing, 0, -0.05),
            "LeftLeg": (0.05 + 0.5 * share * bent, 0, 0), "RightLeg": (0.05 + 0.5 * share * (2 - bent), 0, 0),
            "LeftFoot": (0.2 * share * swing, 0, 0), "RightFoot": (-0.2 * share * swing, 0, 0),
            "LowerBack": (0.05, 0.1 * share * swing, 0), "Spine1": (0.05, 0.1 * share * swing, 0), "Head": (0.1, 0.3 * share * swing, 0),
        }  # fmt: skip
        pose = jc.rest_pose(skeleton)
        turns = np.array(pose.rotations)
        for name, angle in angles.items():
            turns[skeleton.index(name)] = np.asarray(rotation.exp(jnp.asarray(angle, float)))
        turns[0] = np.asarray(rotation.exp(jnp.asarray([0.0, facing + 0.02 * share * frame, 0.0])))
        shifts = np.array(pose.translations)
        shifts[0] = [0.03 * share * frame, 0, 0.5]
        poses.append(jc.Pose(jnp.asarray(shifts), jnp.asarray(turns), pose.scale))
    return subject, jc.stack_poses(poses).poses


def unlabelled_take(
    subject: Subject, poses: jc.Pose, labels: list[str], rng: np.random.Generator
) -> tuple[MarkerFrames, list[str]]:
    """Place a laboratory's markers, in random order with numbers as labels; return the true landmarks too."""
    known = recognise_markers(labels)
    order = rng.permutation(len(labels))
    names = [str(known.names[k]) for k in order]
    rows = [subject.labels.index(name) for name in names]
    spread = np.where(known.deviations[order] < 0.025, PLACING, PLACING_LOOSE)[:, None]
    offsets = np.array(subject.offsets)
    offsets[rows] += spread * rng.normal(size=(len(rows), 3))
    placed = eqx.tree_at(lambda s: s.offsets, subject, jnp.asarray(offsets, subject.offsets.dtype))
    places = np.asarray(_all_places(placed, poses), float)[:, rows]
    places += NOISE * rng.normal(size=places.shape)
    return jc.make_markers(places, [f"*{k}" for k in range(len(rows))], 60.0), names


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers.markers_geometry", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--builds", type=int, default=2, help="number of people")
    parser.add_argument("--laboratories", nargs="+", choices=list(LABORATORIES), default=list(LABORATORIES))
    options = parser.parse_args()
    table, rows, seconds = landmarks(), [], []
    for build in range(options.builds):
        subject, poses = walking_person(build)
        for laboratory in options.laboratories:
            frames, names = unlabelled_take(subject, poses, LABORATORIES[laboratory], np.random.default_rng([build, 7]))  # fmt: skip
            start = time.perf_counter()
            try:
                found = jc.markers.recognise_by_geometry(frames).marker_set.names
            except InputError as error:
                found = None
                progress(f"build {build} {laboratory}: refused: {str(error)[:110]}")
            seconds.append(time.perf_counter() - start)
            pairs = [(a, b) for a, b in zip(found or (), names, strict=False) if a is not None]
            off = [f"{b} as {a}" for a, b in pairs if table[a].bone != table[b].bone]
            rows.append({"refused": found is None, "wrong": len(off), "named": len(pairs), "same": sum(a == b for a, b in pairs), "all": len(names)})  # fmt: skip
            if found is not None:
                progress(
                    f"build {build} {laboratory}: {len(pairs)} of {len(names)} named, on another bone: {off}"
                )
    sets = len(rows)
    named = sum(row["named"] for row in rows)
    figures = {
        "right_share": sum(not row["refused"] and not row["wrong"] for row in rows) / sets,
        "refused_share": sum(row["refused"] for row in rows) / sets,
        "wrong_bone_share": sum(row["wrong"] for row in rows) / max(named, 1),
        "named_share": named / max(sum(row["all"] for row in rows if not row["refused"]), 1),
        "same_landmark_share": sum(row["same"] for row in rows) / max(named, 1),
    }
    limits = {"right_share": (">=", 0.8), "wrong_bone_share": ("<=", 0.0)}
    finish("markers_geometry", figures, limits, {"builds": options.builds}, {"recognition": seconds})


if __name__ == "__main__":
    main()
