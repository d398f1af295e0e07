"""Estimate right hip and knee from functional trials, without a template: `python -m benchmarks.markers_biobuddy`.

One person with 73 markers: a static pose, a trial of the right hip, one of the right knee (Pyomeca's
BioBuddy). Segments are found in all three together, with no labels; labels only say afterwards which
segment is which. The hip's centre from either half of its trial is compared in the pelvis, the thigh's
length from the hip's trial with that from the knee's, and the medial knee marker has to be found
loose: it sits 95 mm from the lateral one in the static pose, 114 mm in the trials.
"""

import numpy as np

from benchmarks._scenes import shared_folder
from benchmarks.report import Timer, finish, progress
from jaxcap.io.registry import read_markers
from jaxcap.markers.rotation_centres.estimate_joint import CentreMethod, find_joint
from jaxcap.markers.rotation_centres.joint import Joint
from jaxcap.markers.segments.find_segments import find_partition
from jaxcap.markers.segments.relative_motion import relative_motion
from jaxcap.markers.segments.segment_frames import SegmentFrames, fit_segment_frames
from jaxcap.markers.segments.segment_sets import Segments, make_segments

TRIALS = ("static", "right_hip", "right_knee")
PELVIS = ("LASIS", "RASIS", "LPSIS", "RPSIS")
THIGH = ("RTHI1", "RTHI2", "RTHI3")
SHANK = ("RLEG1", "RLEG2", "RLEG3")


def dominant_segment(segments: Segments, labels: tuple[str, ...], names: tuple[str, ...]) -> int:
    """Find the segment with most of some markers."""
    owners = segments.marker_segments[[labels.index(name) for name in names]]
    return int(np.bincount(owners[owners >= 0], minlength=segments.num_segments).argmax())


class Trial:
    """Frames of the segments over all trials, with common axes; finds joints in some of the frames."""

    def __init__(self, places: np.ndarray, segments: Segments):
        self.places, self.segments = places, segments
        self.seen = np.ones(places.shape[:2], bool)
        self.frames = fit_segment_frames(places, self.seen, segments)

    def joint(self, parent: int, child: int, chosen: slice, method: CentreMethod) -> Joint:
        frames = self.frames
        some = SegmentFrames(
            frames.rotations[chosen], frames.origins[chosen], frames.known[chosen], frames.local_positions
        )
        between = relative_motion(self.places[chosen], self.seen[chosen], self.segments, some, parent, child)
        assert between is not None
        return find_joint(between, parent, child, method)


def thigh_lengths(trial: Trial, hip: Joint, knee: Joint, chosen: slice) -> np.ndarray:
    """Compute the distance from the hip, fixed in the pelvis, to the knee, fixed in the shank, in each of some frames."""
    frames = trial.frames
    ends = [
        frames.rotations[chosen, segment] @ place + frames.origins[chosen, segment]
        for segment, place in ((0, hip.in_parent), (2, knee.in_child))
    ]
    return np.linalg.norm(ends[1] - ends[0], axis=1)


def print_joint(name: str, joint: Joint) -> None:
    what = " across its axis, a hinge" if joint.axis_in_parent is not None else ""
    across = joint.deviations[:2] if what else joint.deviations
    progress(
        f"{joint.method}, {name}: residual {1e3 * joint.residual:.1f} mm, swept {np.degrees(joint.swept_angle):.0f} degrees, "
        f"standard deviations {', '.join(f'{1e3 * d:.1f}' for d in across)} mm{what}"
    )


def main() -> None:
    folder = shared_folder() / "data" / "markers"
    read = [read_markers(folder / f"biobuddy_{name}.c3d") for name in TRIALS]
    labels = read[0].labels
    order = [[one.labels.index(label) for label in labels] for one in read]
    places = np.concatenate(
        [np.asarray(one.positions, float)[:, o] for one, o in zip(read, order, strict=True)]
    )
    ends = np.cumsum([len(one) for one in read])
    hip_trial, knee_trial = slice(ends[0], ends[1]), slice(ends[1], ends[2])
    timer = Timer()
    found = timer(find_partition, places, np.ones(places.shape[:2], bool)).segments
    pelvis, thigh, shank = (dominant_segment(found, labels, names) for names in (PELVIS, THIGH, SHANK))
    for name, segment in (("pelvis", pelvis), ("thigh", thigh), ("shank", shank)):
        progress(f"{name}: {', '.join(labels[m] for m in found.members[segment])}")
    chosen = [found.members[k] for k in (pelvis, thigh, shank)]
    weights = np.where(found.weights > 0, found.weights, 1.0)
    trial = timer(Trial, places, make_segments(chosen, len(labels), weights))
    middle = (hip_trial.start + hip_trial.stop) // 2
    halves = (slice(hip_trial.start, middle), slice(middle, hip_trial.stop))
    figures: dict[str, float] = {"medial_knee_loose": float(found.is_loose[labels.index("RMFE")])}
    for method in ("score", "sphere", "gamage"):
        first, second = (timer(trial.joint, 0, 1, half, method) for half in halves)
        hip, knee = trial.joint(0, 1, hip_trial, method), trial.joint(1, 2, knee_trial, method)
        for name, joint in (
            ("hip, first half", first),
            ("hip, second half", second),
            ("hip", hip),
            ("knee", knee),
        ):
            print_joint(name, joint)
        lengths = [thigh_lengths(trial, hip, knee, some) for some in (hip_trial, knee_trial)]
        hip_mm, knee_mm = (1e3 * float(np.median(some)) for some in lengths)
        end = "" if method == "score" else f"_{method}"
        figures[f"hip_moves_mm{end}"] = 1e3 * float(np.linalg.norm(first.in_parent - second.in_parent))
        # what the two halves themselves say of how far they may be apart
        figures[f"hip_predicted_mm{end}"] = 1e3 * float(
            np.linalg.norm([*first.deviations, *second.deviations])
        )
        figures[f"thigh_hip_trial_mm{end}"], figures[f"thigh_knee_trial_mm{end}"] = hip_mm, knee_mm
        figures[f"thigh_differs_mm{end}"] = abs(hip_mm - knee_mm)
    limits = {"hip_moves_mm": ("<=", 5.0), "thigh_differs_mm": ("<=", 10.0), "medial_knee_loose": ("==", 1.0)}
    sizes = {"markers": len(labels), "frames": len(places), "segments": found.num_segments}
    finish("markers_biobuddy", figures, limits, sizes, timer.seconds)


if __name__ == "__main__":
    main()
