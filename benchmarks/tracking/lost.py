"""Measure how reliably wrong poses are flagged, and correct ones are not.

    python -m benchmarks.lost
    python -m benchmarks.lost --scenes crane --frames 30

Subjects move through CMU takes, whole, seen from the front only, by a camera, and clothed: their surface lies up to 60 mm
outside of the body's about the thighs and the trunk, and swings. The crane capture is real, in a jacket. Thresholds were tuned
on some scenes; those named `test_` were left out. A body is tracked from the true first pose. At every few frames wrong poses
are made from the tracked one (legs or arms swapped, joints folded, half a turn about the vertical, and the cloud of another
person in another pose and place), and fitted to the cloud as the tracker would, so that they end in the nearest pose that
explains some of it. The joints alone decide which poses are correct: a pose without a main joint that is off by more than 60 mm
is correct, one with a joint off by more than 150 mm is incorrect, made or tracked, and poses between these are listed but not
counted. A flag is any verdict but `good`; a tracked frame is also flagged where the joints that are off by so much are named as
parts that no points show. Flags of correct poses are false positives, and the share of incorrect poses that are flagged is the
recall. In `slow` scenes a limb leaves the points by half a degree a frame, for ten seconds, and each frame updates the baseline;
in `swapped` ones the legs of the first frame are exchanged.
Run it from the root of the checkout.
"""

import argparse
import time
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxcap as jc
from benchmarks._crane import frame_cloud, load_crane, rig_crane, true_distances
from benchmarks._scenes import Noise, Visible, clothing_offsets, human_motion, scan_frame, shared_folder
from benchmarks.report import finish, progress
from jaxcap.metrics import scan_to_surface
from jaxcap.report.distance_pictures import FrameView, draw_views
from jaxcap.tracking.judge_frame import (
    TrackedFrame,
    judge_frame,
    reset_velocity,
    track_frame_jit,
)
from jaxcap.tracking.judgement.baseline import initial_baseline
from jaxcap.tracking.judgement.region_samples import sample_regions
from jaxcap.tracking.track_frame import start_state

#: error of the main joints up to which a pose is correct, and beyond which it is incorrect, millimetres
MAX_CORRECT_ERROR, MIN_INCORRECT_ERROR = 60.0, 150.0
#: steps of the tracker from a made pose
STEPS = 4
#: joints that errors are taken at
MAIN_JOINTS = (
    "Hips", "LeftLeg", "LeftFoot", "RightLeg", "RightFoot", "Spine1", "Head",
    "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand",
)  # fmt: skip
LIMBS = {"legs": ("UpLeg", "Leg", "Foot"), "arms": ("Arm", "ForeArm", "Hand")}
FOLDING = ("Arm", "ForeArm", "UpLeg", "Leg")
#: outliers, noise and numbers of points differ, and so do people
SCENES: dict[str, tuple[str, str, Visible, bool, Noise]] = {
    "whole": ("male", "01_01", "whole", False, Noise()),
    "whole_clothed": ("male", "01_08", "whole", True, Noise()),
    "front": ("male", "01_05", "front", False, Noise()),
    "front_clothed": ("male", "01_01", "front", True, Noise()),
    "camera": ("male", "01_08", "camera", False, Noise()),
    "test_whole": ("female", "02_05", "whole", False, Noise(3000, 0.01, 20.0, 0.03)),
    "test_whole_clothed": ("female", "02_07", "whole", True, Noise(8000, 0.002, 5.0, 0.2)),
    "test_front": ("female", "02_08", "front", False, Noise(5000, 0.005, 10.0, 0.0)),
    "test_front_clothed": ("female", "02_05", "front", True, Noise(2000, 0.01, 10.0, 0.1)),
    "test_camera": ("female", "02_07", "camera", False, Noise()),
}
#: what is wrong from the beginning or grows, on such a scene
HARD: dict[str, str] = {
    "slow": "whole",
    "swapped": "front",
    "late": "camera",
    "test_slow": "test_front",
    "test_swapped": "test_whole",
    "test_late": "test_front",
}
#: degrees a frame by which a limb leaves the points, and frames
SLOW, SLOW_FRAMES = 0.25, 300
#: frames without anyone
NUM_EMPTY_FRAMES = 4

_posed = eqx.filter_jit(jc.pose_body)


class JudgedPose(NamedTuple):
    """A pose and its verdict."""

    kind: str
    frame: int
    #: of the main joints, millimetres
    errors: np.ndarray
    tracked: TrackedFrame
    cloud: jc.Cloud

    #: for each error the joint and its parent
    parts: tuple[frozenset[str], ...] = ()

    @property
    def flagged(self) -> bool:
        """True if the frame is flagged, or all wrong parts are reported as unseen."""
        unseen = set(self.tracked.unseen)
        wrong = [
            unseen & parts
            for parts, error in zip(self.parts, self.errors, strict=False)
            if error > MIN_INCORRECT_ERROR
        ]
        return self.tracked.verdict != "good" or (bool(wrong) and all(wrong))


def joints_of(body: jc.Body, pose: jc.Pose) -> np.ndarray:
    return np.asarray(_posed(body, pose).joints, float)


def rotate_joint(pose: jc.Pose, joint: int, turn: Rotation) -> jc.Pose:
    """Rotate one joint of a pose in its parent's frame."""
    rotations = np.array(pose.rotations)
    now = Rotation.from_quat(rotations[joint], scalar_first=True)
    rotations[joint] = (turn * now).as_quat(scalar_first=True)
    return jc.Pose(pose.translations, jnp.asarray(rotations, pose.rotations.dtype), pose.scale)


def point_chain(body: jc.Body, pose: jc.Pose, chain: list[int], targets: np.ndarray) -> jc.Pose:
    """Rotate the bones of a chain so that they point to `targets (n, 3)`."""
    for joint, child, target in zip(chain[:-1], chain[1:], targets, strict=True):
        posed = _posed(body, pose)
        joints, bones = np.asarray(posed.joints, float), np.asarray(posed.transforms.rotations, float)
        turn, _ = Rotation.align_vectors(target - joints[joint], joints[child] - joints[joint])
        parent = Rotation.from_matrix(bones[body.skeleton.parents[joint]] / float(pose.scale))
        pose = rotate_joint(pose, joint, parent.inv() * turn * parent)
    return pose


def make_incorrect_poses(body: jc.Body, pose: jc.Pose, rng: np.random.Generator) -> dict[str, jc.Pose]:
    """Make incorrect poses from a correct one."""
    skeleton, joints = body.skeleton, joints_of(body, pose)
    wrong = {}
    for name, limb in LIMBS.items():
        sides = [[skeleton.index(f"{side}{part}") for part in limb] for side in ("Left", "Right")]
        swapped = point_chain(body, pose, sides[0], joints[sides[1]][1:])
        wrong[name] = point_chain(body, swapped, sides[1], joints[sides[0]][1:])
    for name in ("folded", "folded_more"):
        folded = pose
        for part in rng.choice(FOLDING, 1 if name == "folded" else 3, replace=False):
            joint = skeleton.index(f"{rng.choice(['Left', 'Right'])}{part}")
            axis = rng.normal(size=3)
            angle = np.radians(rng.uniform(80, 170))
            folded = rotate_joint(folded, joint, Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)))
        wrong[name] = folded
    middle = np.median(np.asarray(_posed(body, pose).vertices, float), 0)
    about = rotate_joint(pose, 0, Rotation.from_rotvec([0.0, np.pi, 0.0]))
    shift = (np.array([-1.0, 1.0, -1.0]) * (joints[0] - middle) + middle - joints[0]) / float(pose.scale)
    places = about.translations.at[0].add(jnp.asarray(shift, about.translations.dtype))
    wrong["half_turn"] = jc.Pose(places, about.rotations, about.scale)
    return wrong


class Scene:
    """A body, its clouds and its true joints, tracked and judged frame by frame."""

    def __init__(self, body: jc.Body, clouds: list[jc.Cloud], errors, others: list, every: int, seed: int):
        self.tracker, self.surface = jc.make_tracker(body), sample_regions(body)
        self.body, self.clouds, self.errors, self.others = body, clouds, errors, others
        self.every, self.rng = every, np.random.default_rng(seed)

    def fitted(self, pose: jc.Pose, cloud: jc.Cloud, baseline) -> TrackedFrame:
        state = start_state(self.tracker, pose, 0.02)
        for _ in range(STEPS):
            state, statistics = track_frame_jit(self.tracker, reset_velocity(self.tracker, state), cloud)
        return judge_frame(self.surface, cloud, state, statistics, baseline)

    def run(self, start: jc.Pose | None, search: bool | Literal["auto"] = False) -> list[JudgedPose]:
        judged, frames = [], jc.fit.track_frames(self.tracker, self.clouds, start, search=search, sigma=0.05)
        baseline, parts = None, parts_of(self.body)
        for number, (frame, cloud) in enumerate(zip(frames, self.clouds, strict=True)):
            errors = self.errors(number, frame.pose)
            # the crane's errors are of parts
            judged.append(
                JudgedPose(
                    "tracked", number, errors, frame, cloud, parts if len(errors) == len(parts) else ()
                )
            )
            if self.every and number % self.every == self.every - 1:
                assert baseline is not None
                for kind, pose in make_incorrect_poses(self.body, frame.pose, self.rng).items():
                    made = self.fitted(pose, cloud, baseline)
                    judged.append(JudgedPose(kind, number, self.errors(number, made.pose), made, cloud))
                if self.others:
                    other, joints = self.others[number % len(self.others)]
                    here = joints_of(self.body, frame.pose)[0] - joints[0]
                    away = self.rng.uniform(-0.5, 0.5, 3) * [1.0, 0.0, 1.0]
                    shift = here * [1.0, 0.0, 1.0] + away
                    moved = eqx.tree_at(
                        lambda c: c.points, other, other.points + jnp.asarray(shift, other.points.dtype)
                    )
                    made = self.fitted(frame.pose, moved, baseline)
                    main = [self.body.skeleton.index(name) for name in MAIN_JOINTS]
                    differences = joints_of(self.body, made.pose)[main] - (joints + shift)[main]
                    errors = 1000 * np.linalg.norm(differences, axis=1)
                    judged.append(JudgedPose("other_person", number, errors, made, moved))
            baseline = frame.baseline
        return judged


def parts_of(body: jc.Body) -> tuple[frozenset[str], ...]:
    """List for each of `MAIN_JOINTS` the joint and its parent."""
    names, parents = body.skeleton.names, body.skeleton.parents
    return tuple(
        frozenset({name, *((names[parents[names.index(name)]],) if parents[names.index(name)] >= 0 else ())})
        for name in MAIN_JOINTS
    )


def slow_fault(scene: Scene, motion: jc.Motion, joint: str) -> list[JudgedPose]:
    """Judge true poses with one joint that rotates further in each frame; good frames update the baseline."""
    judged, baseline = [], initial_baseline(scene.surface)
    for number, cloud in enumerate(scene.clouds):
        turn = Rotation.from_rotvec([0.0, 0.0, np.radians(SLOW * max(0, number - 10))])
        pose = rotate_joint(motion[number], scene.body.skeleton.index(joint), turn)
        state = start_state(scene.tracker, pose, 0.02)
        _, statistics = track_frame_jit(scene.tracker, reset_velocity(scene.tracker, state), cloud)
        frame = judge_frame(scene.surface, cloud, state, statistics, baseline)
        baseline = frame.baseline
        judged.append(JudgedPose("slow", number, scene.errors(number, pose), frame, cloud))
    return judged


def human_scene(name: str, shared: Path, frames: int, every: int, first: int = 30) -> list[JudgedPose]:
    kind = name.removeprefix("test_") if name in HARD else ""
    sex, take, visible, clothed, noise = SCENES[HARD.get(name, name)]
    if kind == "slow":
        frames = SLOW_FRAMES
    subject, body = jc.human(sex=sex), jc.human(sex=sex, resolution="medium")
    stranger = jc.human(sex="female" if sex == "male" else "male")
    motion = human_motion(shared, take, subject)
    first = max(0, min(first, motion.num_frames - frames))
    motion = motion.slice(slice(first, first + frames))
    clothes = clothing_offsets(subject) if clothed else None
    rngs = [np.random.default_rng([len(name), frame]) for frame in range(motion.num_frames)]
    scans = [
        scan_frame(subject, motion[k], rng, noise, visible, clothes=clothes) for k, rng in enumerate(rngs)
    ]
    theirs = human_motion(shared, "02_03" if sex == "male" else "01_11", stranger).slice(slice(0, 120, 17))
    others = [scan_frame(stranger, theirs[k], rngs[0], noise, visible) for k in range(theirs.num_frames)]
    main = [body.skeleton.index(joint) for joint in MAIN_JOINTS]

    def errors(number: int, pose: jc.Pose) -> np.ndarray:
        return 1000 * np.linalg.norm((joints_of(body, pose) - scans[number].joints)[main], axis=1)

    clouds = [scan.cloud for scan in scans]
    if kind == "late":
        nobody = [rngs[k].uniform(-1.0, 1.0, (500, 3)) for k in range(NUM_EMPTY_FRAMES)]
        clouds[:NUM_EMPTY_FRAMES] = [
            jc.make_cloud(points, rngs[0].normal(size=points.shape)) for points in nobody
        ]
    strangers = [] if kind else [(scan.cloud, scan.joints) for scan in others]
    scene = Scene(body, clouds, errors, strangers, 0 if kind else every, 1)
    if kind == "slow":
        return slow_fault(scene, motion, "LeftArm" if sex == "male" else "RightUpLeg")
    if kind == "swapped":
        return scene.run(make_incorrect_poses(body, motion[0], np.random.default_rng(3))["legs"], "auto")
    return scene.run(None, "auto") if kind else scene.run(motion[0])


def crane_scene(shared: Path, frames: int, every: int) -> list[JudgedPose]:
    """Track the crane subject. The error of a part is the mean distance of its vertices; 13 mm of it are due to clothes."""
    crane = load_crane(shared)
    body = rig_crane(crane)
    parts = np.asarray(body.skin.dominant_bones())

    def errors(number: int, pose: jc.Pose) -> np.ndarray:
        distances = 1000 * true_distances(crane, number, np.asarray(_posed(body, pose).vertices))
        return np.array([distances[parts == part].mean() for part in np.unique(parts)])

    clouds = [frame_cloud(crane, frame) for frame in range(min(frames, len(crane.frames)))]
    return Scene(body, clouds, errors, [], every, 2).run(jc.rest_pose(body.skeleton))


def count_verdicts(judged: list[JudgedPose]) -> dict[str, object]:
    """Count verdicts on correct poses (negatives) and incorrect ones (positives); a flag is a positive result."""
    later = [one for one in judged if one.kind == "tracked" and one.frame > 0]
    correct = [one for one in later if one.errors.max() < MAX_CORRECT_ERROR]
    tracked = [one for one in later if one.errors.max() > MIN_INCORRECT_ERROR]
    made = [one for one in judged if one.kind != "tracked" and one.errors.max() > MIN_INCORRECT_ERROR]
    ambiguous = [
        one
        for one in judged
        if one.kind == "tracked" and MAX_CORRECT_ERROR <= one.errors.max() <= MIN_INCORRECT_ERROR
    ]
    kinds = sorted({one.kind for one in made})
    of_kind = {kind: [one for one in made if one.kind == kind] for kind in kinds}
    return {
        "correct": len(correct),
        "false_positives": sum(one.tracked.verdict != "good" for one in correct),
        "correct_lost": sum(one.tracked.lost for one in correct),
        "correct_with_unseen_parts": sum(bool(one.tracked.unseen) for one in correct),
        "incorrect": len(made),
        "true_positives": sum(one.flagged for one in made),
        "true_positives_by_kind": {
            kind: [sum(one.flagged for one in ones), len(ones)] for kind, ones in of_kind.items()
        },
        "tracked_incorrect": len(tracked),
        "tracked_true_positives": sum(one.flagged for one in tracked),
        "tracked_true_positives_by_unseen_parts": sum(
            one.flagged and one.tracked.verdict == "good" for one in tracked
        ),
        "ambiguous": len(ambiguous),
        "ambiguous_flagged": sum(one.flagged for one in ambiguous),
        "first_frame": judged[0].tracked.verdict,
    }


def picture(path: Path, name: str, body: jc.Body, judged: list[JudgedPose]) -> None:
    """Draw one case of each kind."""
    views, faces = [], np.asarray(body.faces)
    for kind in sorted({one.kind for one in judged}):
        one = [case for case in judged if case.kind == kind][-1]
        vertices = np.asarray(_posed(body, one.tracked.pose).vertices, float)
        points = np.asarray(one.cloud.points[one.cloud.weights > 0], float)
        middle = vertices.mean(0) * [1.0, 0.0, 1.0]
        title = f"{kind}: {one.tracked.verdict}"
        distances = scan_to_surface(points, vertices, faces)
        views.append(FrameView(title, vertices - middle, points - middle, distances))
    draw_views(path, views, faces, name)
    progress(f"picture: {path}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lost", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--scenes", nargs="+", choices=("crane", *SCENES, *HARD), default=("crane", *SCENES, *HARD)
    )
    parser.add_argument("--frames", type=int, default=175, help="number of frames of each scene")
    parser.add_argument("--every", type=int, default=12, help="generate incorrect poses at every n-th frame")
    parser.add_argument(
        "--picture", type=Path, help="write a PNG with a case of each kind from the first scene"
    )
    options = parser.parse_args()
    shared, scenes, seconds = shared_folder(), {}, {}
    for name in options.scenes:
        start = time.perf_counter()
        if name == "crane":
            judged = crane_scene(shared, options.frames, options.every)
        else:
            judged = human_scene(name, shared, options.frames, options.every)
        seconds[name] = time.perf_counter() - start
        scenes[name] = count_verdicts(judged)
        progress(f"{name}: {scenes[name]}, {seconds[name]:.0f} s")
        for one in judged:
            false_positive = (
                one.kind == "tracked"
                and one.errors.max() < MAX_CORRECT_ERROR
                and one.tracked.verdict != "good"
            )
            missed = one.errors.max() > MIN_INCORRECT_ERROR and not one.flagged
            if false_positive or missed:
                what = (
                    f"{one.tracked.verdict}, {', '.join(one.tracked.reasons)}" if false_positive else "missed"
                )
                progress(f"  {one.kind} {one.frame}: {one.errors.max():.0f} mm, {what}")
        if options.picture and name == options.scenes[0]:
            body = rig_crane(load_crane(shared)) if name == "crane" else None
            body = body or jc.human(sex=SCENES[HARD.get(name, name)][0], resolution="medium")
            picture(options.picture, name, body, judged)

    def share(over: str, of: str, is_test: bool) -> float:
        some = [value for name, value in scenes.items() if name.startswith("test_") == is_test]
        return 100 * sum(s[over] for s in some) / max(sum(s[of] for s in some), 1)

    figures: dict[str, object] = {"scenes": scenes}
    limits = {}
    for is_test, prefix in ((False, ""), (True, "test_")):
        if any(name.startswith("test_") == is_test for name in scenes):
            figures[f"{prefix}false_positive_rate_percent"] = share("false_positives", "correct", is_test)
            figures[f"{prefix}recall_percent"] = share("true_positives", "incorrect", is_test)
            figures[f"{prefix}tracked_recall_percent"] = share(
                "tracked_true_positives", "tracked_incorrect", is_test
            )
            limits[f"{prefix}false_positive_rate_percent"] = ("<", 1.0)
            limits[f"{prefix}recall_percent"] = (">", 98.0)
            limits[f"{prefix}tracked_recall_percent"] = (">", 98.0)
    sizes = {
        "frames": options.frames,
        "every": options.every,
        "correct_mm": MAX_CORRECT_ERROR,
        "incorrect_mm": MIN_INCORRECT_ERROR,
    }
    finish("lost", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
