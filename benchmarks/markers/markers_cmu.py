"""Estimate a skeleton from 41 unlabelled markers: `python -m benchmarks.markers_cmu`.

CMU's take 02_05, punches and strikes: raw markers, and the database's own skeleton and motion of the
same frames. Markers are shuffled and their labels hidden; what is found is compared with the database:

- Each bone found is one of the database's: that which carries its markers best. A joint is compared with
  the nearest one on the way between its two bones, after the best constant offset in the frame of that
  joint's parent, as the database puts its centres elsewhere in its bones. Two bones that are joined with
  a third one's between them are a wrong edge of the tree.
- The residual of the markers, with that of the database's skeleton, each marker on the bone that
  carries it best.
"""

import argparse
from pathlib import Path

import jax
import numpy as np

import jaxcap as jc
from benchmarks._scenes import cmu_motion, shared_folder
from benchmarks.report import Timer, finish, progress

TAKE = "02_05"
#: the database's x, y, z are the markers' y, z, x
AXES = [1, 2, 0]


def hide_labels(frames: jc.MarkerFrames, seed: int) -> tuple[jc.MarkerFrames, tuple[str, ...]]:
    """Permute markers and replace their labels by numbers, in the database's axes; also return the labels."""
    order = np.random.default_rng(seed).permutation(len(frames.labels))
    places = np.asarray(frames.positions)[:, order][..., AXES]
    names = tuple(f"point{i}" for i in range(len(order)))
    shuffled = jc.MarkerFrames(places, np.asarray(frames.visible)[:, order], names, frames.rate)
    return shuffled, tuple(frames.labels[i] for i in order)


def bone_frames(skeleton: jc.Skeleton, motion: jc.Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute rotations (F, J, 3, 3), translations and centres (F, J, 3) of all bones."""

    def of_frame(pose):
        transforms = jc.forward_kinematics(skeleton, pose)
        return transforms.rotations, transforms.translations

    r, t = (np.asarray(x, float) for x in jax.jit(lambda poses: jax.lax.map(of_frame, poses))(motion.poses))
    return r, t, np.einsum("fjab,jb->fja", r, np.asarray(skeleton.centres, float)) + t


def offset_spread(rotations: np.ndarray, origins: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Compute the distances (F,) of points from their best constant position in a moving frame, metres."""
    local = np.einsum("fba,fb->fa", rotations, points - origins)
    return np.linalg.norm(local - local.mean(0), axis=1)


def bones_between(skeleton: jc.Skeleton, start: int, end: int) -> list[int]:
    """List the bones on the path from one bone to another, both included."""
    up = [[start], [end]]
    for path in up:
        while skeleton.parents[path[-1]] >= 0:
            path.append(skeleton.parents[path[-1]])
    common = next((bone for bone in up[0] if bone in up[1]), -1)
    first, second = (path[: path.index(common) + 1] if common >= 0 else path for path in up)
    return [*first, *(bone for bone in reversed(second) if bone != common)]


def joints_between(skeleton: jc.Skeleton, start: int, end: int) -> list[int]:
    """List the joints between two bones."""
    way = bones_between(skeleton, start, end)
    return [bone for bone in way if skeleton.parents[bone] in way]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.markers_cmu", description="Fit a skeleton to 41 unlabelled markers."
    )
    parser.add_argument("--frames", type=int, help="number of frames to use")
    parser.add_argument("--local", action="store_true", help="stop after the local technique")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random order of markers")
    parser.add_argument("--picture", type=Path, help="write a PNG of the skeleton and its markers")
    options = parser.parse_args()
    shared = shared_folder()
    frames = jc.read_markers(shared / "data" / "markers" / f"cmu_{TAKE}.c3d")[: options.frames]
    motion, skeleton = cmu_motion(shared, TAKE)
    motion = motion.slice(slice(options.frames))
    frames, called = hide_labels(frames, options.seed)
    timer = Timer()
    found = timer(jc.markers.fit_local, frames)
    for name, members in zip(found.segments.names, found.segments.members, strict=True):
        progress(f"{name}: {', '.join(called[m] for m in members)}")
    calibrated = None if options.local else timer(jc.markers.calibrate, found.markers, found.subject)
    subject = found.subject if calibrated is None else calibrated.subject
    solution = timer(jc.markers.solve_markers, subject, frames)
    for sentence in (
        *found.messages,
        *(() if calibrated is None else calibrated.messages),
        *solution.messages,
    ):
        progress(f"message: {sentence}")

    r, t, centres = bone_frames(skeleton, motion)
    _, _, ours = bone_frames(subject.skeleton, solution.motion)
    seen, places = np.asarray(frames.visible), np.asarray(frames.positions, float)
    best, squares = np.full(places.shape[:2], np.nan), np.zeros((places.shape[1], skeleton.num_joints))
    for marker, shown in enumerate(seen.T):
        each = [
            offset_spread(r[shown, j], t[shown, j], places[shown, marker]) for j in range(skeleton.num_joints)
        ]
        squares[marker] = [float(np.mean(one**2)) for one in each]
        best[shown, marker] = each[int(squares[marker].argmin())]
    # the database's bone of each of our bones: the one that carries its markers best
    theirs = [
        int(squares[np.asarray(subject.bones) == bone].sum(0).argmin()) for bone in range(ours.shape[1])
    ]
    off, raw, wrong = {}, {}, 0
    for mine, parent in enumerate(subject.skeleton.parents):
        if parent < 0:
            continue
        between = joints_between(skeleton, theirs[mine], theirs[parent])
        # somebody else's bone on the way: these two are not neighbours
        inside = set(bones_between(skeleton, theirs[mine], theirs[parent])) - {theirs[mine], theirs[parent]}
        astray = bool(inside & set(theirs))
        wrong += astray
        apart = {
            j: float(np.linalg.norm(ours[:, mine] - centres[:, j], axis=1).mean())
            for j in between or range(1, skeleton.num_joints)
        }
        joint = min(apart, key=lambda j: apart[j])
        name = f"{subject.skeleton.names[mine]} {skeleton.names[joint]}"
        above = skeleton.parents[joint]
        off[name] = 1e3 * float(offset_spread(r[:, above], centres[:, above], ours[:, mine]).mean())
        raw[name] = 1e3 * apart[joint]
        progress(
            f"{name}: {off[name]:.1f} mm after the offset, {raw[name]:.1f} mm before{', not neighbours' if astray else ''}"
        )

    held = np.asarray(subject.weights)[[subject.labels.index(label) for label in frames.labels]] > 0
    mine = solution.residuals[:, [subject.labels.index(label) for label in frames.labels]]
    figures = {
        "joints_mm": float(np.mean(list(off.values()))),
        "joints_raw_mm": float(np.mean(list(raw.values()))),
        "joints": len(off),
        "edges_wrong": int(wrong),
        "markers_held": int(held.sum()),
        "residual_mm": 1e3 * float(np.sqrt(np.nanmean(mine[:, held] ** 2))),
        "database_residual_mm": 1e3 * float(np.sqrt(np.nanmean(best[:, held] ** 2))),
        "lost": int(solution.lost.sum()),
        "database_each_mm": dict(zip(called, 1e3 * np.sqrt(np.nanmean(best**2, 0)), strict=True)),
        "joints_each_mm": off,
    }
    figures["residual_share"] = figures["residual_mm"] / figures["database_residual_mm"]
    limits = {"joints_mm": ("<=", 15.0), "residual_share": ("<=", 1.0)}
    if options.picture:
        from jaxcap.report.markers.marker_pictures import draw_skeleton

        draw_skeleton(options.picture, subject, solution.motion, frames, solution.residuals, f"CMU {TAKE}")
        progress(f"picture: {options.picture}")
    sizes = {"frames": len(frames), "markers": len(frames.labels), "bones": subject.skeleton.num_joints}
    finish("markers_cmu", figures, limits, sizes, timer.seconds)


if __name__ == "__main__":
    main()
