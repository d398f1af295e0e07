"""Compare how other programs read our files: `python -m benchmarks.exchange --programs FOLDER`.

Bodies with motions go out as `.glb`, USD and `.bvh`. Khronos's validator reads the first; Blender imports all three, and
its joints and evaluated vertices are compared with ours; three.js loads the `.glb` in a browser without a window, and its
skinned vertices and two pictures are compared with ours; OpenUSD skins what is in the USD file. Programs are installed under
FOLDER where they are not there, in environments of their own; one that does not install is reported and skipped.
`--case NAME BODY MOTION` adds a body of your own. Bodies that do not blend linearly are linearised first, and
others are compared with the linearised body; `linear_mm` is its difference from the body itself.
"""

import argparse
import io
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

import jaxcap as jc
from benchmarks._scenes import shared_folder
from benchmarks.files._exchange import Case, Truth, Written, make_cases, make_truth, write_case
from benchmarks.files._programs.run import (
    HEIGHT,
    WIDTH,
    blender,
    in_blender,
    in_three,
    in_usd,
    node_modules,
    validate,
)
from benchmarks.report import finish, progress
from benchmarks.view._browser import find_chromium
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import take_poses
from jaxcap.io.skeletons.twist_axes import is_end_joint

#: what another program may be off, and what may be changed between two pictures outside of where the body is
MAX_DISTANCE_MM, MAX_ANGLE_DEGREES = 0.1, 0.01
#: pixels that edges are smoothed over
MARGIN = 2


def compare(found: dict[str, Any], truth: Truth, names: list[str]) -> dict[str, float]:
    """Compute the largest distance of a joint and of a vertex, millimetres, and the largest angle between bones, degrees."""
    theirs = [str(name) for name in found["names"]]
    at = [theirs.index(name) for name in names]
    ours = [truth.names.index(name) for name in names]
    figures = {
        "joints_mm": 1000 * np.linalg.norm(found["joints"][:, at] - truth.joints[:, ours], axis=-1).max()
    }
    if "turns" in found:
        apart = np.linalg.norm(found["turns"][:, at] - truth.turns[:, ours], axis=(-2, -1))
        figures["turns_degrees"] = np.degrees(2 * np.arcsin(np.clip(apart / np.sqrt(8), 0, 1))).max()
    if "vertices" in found:
        if found["vertices"].shape != truth.vertices.shape:
            raise RuntimeError(
                f"The file has {found['vertices'].shape[1]} vertices; expected {truth.vertices.shape[1]}."
            )
        figures["vertices_mm"] = 1000 * np.linalg.norm(found["vertices"] - truth.vertices, axis=-1).max()
    return {name: float(value) for name, value in figures.items()}


def bones_of_bvh(skeleton: jc.Skeleton) -> list[str]:
    """List the joints of a skeleton in BVH, without the ends of bones."""
    return [
        name
        for joint, name in enumerate(skeleton.names)
        if not is_end_joint(skeleton.names, skeleton.parents, skeleton.kinds, joint)
    ]


def projected_box(
    vertices: Float[np.ndarray, "T V 3"], centre: Float[np.ndarray, "3"], radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the bounding box of a body in pixels of the page's camera."""
    eye = centre + radius * np.array([1.2, 0.6, 3.4])
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    seen = (vertices - eye) @ np.stack([right, np.cross(ahead, right), ahead], 1)
    pixels = seen[..., :2] / seen[..., 2:] * (HEIGHT / 2) / np.tan(np.radians(17.5))
    pixels = pixels.reshape(-1, 2) + [WIDTH / 2, HEIGHT / 2]
    return pixels.min(0), pixels.max(0)


def picture_changes(pictures: list[bytes], low: np.ndarray, high: np.ndarray) -> dict[str, float]:
    """Compare two pictures: the percentage of body pixels that differ, and the number of changed pixels elsewhere."""
    from matplotlib.image import imread

    first, second = (imread(io.BytesIO(picture))[..., :3] for picture in pictures)
    shown = (first < 0.99).any(-1) | (second < 0.99).any(-1)
    differ = np.abs(first - second).max(-1) > 0.02
    rows, columns = np.nonzero(differ)
    inside = (columns >= low[0] - MARGIN) & (columns <= high[0] + MARGIN)
    inside &= (rows >= low[1] - MARGIN) & (rows <= high[1] + MARGIN)
    return {
        "pictures_differ_percent": 100 * float(differ.sum()) / max(int(shown.sum()), 1),
        "pixels_elsewhere": int((~inside).sum()),
        "body_pixels": int(shown.sum()),
    }


class PreparedCase(NamedTuple):
    """A case, its files, and the expected positions of the linearised body in some frames."""

    case: Case
    written: Written
    frames: list[int]
    truth: Truth


#: of one program: what is called `program`, figures by name, and limits of some of them
Part = tuple[str, dict[str, float], dict[str, tuple[str, float]]]
POSITION_LIMITS = {"joints_mm": ("<=", MAX_DISTANCE_MM), "vertices_mm": ("<=", MAX_DISTANCE_MM)}
ROTATION_LIMITS = {"joints_mm": ("<=", MAX_DISTANCE_MM), "turns_degrees": ("<=", MAX_ANGLE_DEGREES)}


def check_validator(home: Path, work: PreparedCase) -> Iterator[Part]:
    (found,) = validate(home, [work.written.glb]).values()
    for message in found["messages"]:
        progress(f"  {message}")
    figures = {"errors": found["errors"], "warnings": found["warnings"]}
    yield "validator", figures, dict.fromkeys(figures, ("==", 0))


def check_three(home: Path, work: PreparedCase, keep: Path | None) -> Iterator[Part]:
    """Check a case in three.js, which reads four bones per vertex: cases with more are rendered but have no limits."""
    vertices, rate = work.truth.vertices, work.case.motion.rate
    centre = vertices.reshape(-1, 3).mean(0)
    radius = float(np.linalg.norm(vertices - centre, axis=-1).max())
    found = in_three(home, work.written.glb, [frame / rate for frame in work.frames], centre, radius)
    figures = {"errors": len(found["errors"])}
    if found["errors"]:
        progress(f"  {found['errors']}")
        yield "three", figures, {"errors": ("==", 0)}
        return
    pictures = [found["pictures"][0], found["pictures"][-1]]
    figures["vertices_mm"] = 1000 * float(np.linalg.norm(found["vertices"] - vertices, axis=-1).max())
    figures |= picture_changes(pictures, *projected_box(vertices[[0, -1]], centre, radius))
    if keep is not None:
        for name, picture in zip(("first", "last"), pictures, strict=True):
            (keep / f"{work.case.name}-three-{name}.png").write_bytes(picture)
    limits = {"errors": ("==", 0), "pictures_differ_percent": (">=", 1.0)}
    if work.case.influences <= 4:
        limits |= {"vertices_mm": ("<=", MAX_DISTANCE_MM), "pixels_elsewhere": ("==", 0)}
    yield "three", figures, limits


def check_usd(work: PreparedCase) -> Iterator[Part]:
    found = in_usd(work.written.usd, work.frames)
    for message in found["messages"]:
        progress(f"  {message}")
    figures = compare(found, work.truth, list(work.truth.names)) | {"messages": len(found["messages"])}
    yield "usd", figures, POSITION_LIMITS | {"messages": ("==", 0)}


def roundtrip_distance(file: Path, work: PreparedCase) -> float:
    """Compute the largest distance between the vertices that another program wrote and those that it read, millimetres."""
    body, motion = jc.io.read_skinned(file)
    if motion is None:
        raise RuntimeError(f"{file.name} has no animation.")
    poses = take_poses(motion.poses, np.array(work.frames))
    apart = 0.0
    for here, there in zip(work.truth.vertices, np.asarray(posed_vertices(body, poses), float), strict=True):
        apart = max(apart, KDTree(here).query(there)[0].max(), KDTree(there).query(here)[0].max())
    return 1000 * apart


def check_blender(python: Path, work: PreparedCase) -> Iterator[Part]:
    rate = work.case.motion.rate
    # Blender writes keys at whole frames of whole rates
    again = work.written.glb.with_name(f"{work.case.name}-again.glb") if rate == round(rate) else None
    for kind, file in (("glb", work.written.glb), ("usd", work.written.usd)):
        found = in_blender(python, file, rate, work.frames, again if kind == "glb" else None)
        yield (
            f"blender_{kind}",
            compare(found, work.truth, list(work.truth.names)),
            POSITION_LIMITS | ROTATION_LIMITS,
        )
    if again is not None:
        yield (
            "blender_again",
            {"vertices_mm": roundtrip_distance(again, work)},
            {"vertices_mm": ("<=", MAX_DISTANCE_MM)},
        )
    if work.written.bvh is not None:
        body = work.case.body
        found = in_blender(python, work.written.bvh, rate, work.frames)
        truth = make_truth(body, work.case.motion, work.frames)
        yield "blender_bvh", compare(found, truth, bones_of_bvh(body.skeleton)), ROTATION_LIMITS


def prepare_case(folder: Path, case: Case, tolerance: float, count: int) -> PreparedCase:
    written = write_case(folder, case, tolerance)
    frames = np.linspace(0, len(case.motion) - 1, count).round().astype(int)
    frames = sorted(set(frames.tolist()))
    return PreparedCase(case, written, frames, make_truth(written.linear.body, written.motion, frames))


def case_sizes(work: PreparedCase) -> dict[str, float]:
    joints = work.case.body.skeleton.num_joints
    return {
        "vertices": len(work.case.body.vertices),
        "joints": joints,
        "virtual_bones": work.written.linear.body.skeleton.num_joints - joints,
        "linear_mm": 1000 * work.written.linear.error,
        "frames": len(work.case.motion),
    }


def main() -> None:
    programs = ("validator", "blender", "three", "usd")
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.exchange", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--programs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "programs")
    parser.add_argument("--only", nargs="*", choices=programs, default=programs)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--at", type=int, default=6, help="number of compared frames")
    parser.add_argument(
        "--tolerance", type=float, default=0.001, help="tolerance of the linearised body, metres"
    )
    parser.add_argument("--cases", nargs="*", help="names of the cases; all by default")
    parser.add_argument("--case", nargs=3, action="append", default=[], metavar=("NAME", "BODY", "MOTION"))
    parser.add_argument("--no-captures", action="store_true", help="only the cases that need no captures")
    parser.add_argument("--keep", type=Path, help="folder for the files and pictures")
    options = parser.parse_args()
    cases = make_cases(None if options.no_captures else shared_folder(), options.frames)
    for name, body, motion in options.case:
        read = jc.load_body(body)
        cases.append(Case(name, read, jc.load_motion(motion, read.skeleton)))
    cases = [case for case in cases if not options.cases or case.name in options.cases]
    python = blender(options.programs) if "blender" in options.only else None
    home = node_modules(options.programs) if {"validator", "three"} & set(options.only) else None
    there = {"validator": home, "three": home and find_chromium(), "blender": python, "usd": True}
    parts: dict[str, Callable[[PreparedCase], Iterator[Part]]] = {
        "validator": lambda work: check_validator(home, work),
        "three": lambda work: check_three(home, work, options.keep),
        "usd": check_usd,
        "blender": lambda work: check_blender(python, work),
    }
    chosen = {name: part for name, part in parts.items() if name in options.only and there[name]}
    figures: dict[str, Any] = {}
    limits: dict[str, tuple[str, float]] = {}
    sizes: dict[str, Any] = {"left_out": [name for name in options.only if name not in chosen]}
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for case in cases:
            start = time.perf_counter()
            work = prepare_case(folder, case, options.tolerance, options.at)
            sizes[case.name] = case_sizes(work)
            for part in chosen.values():
                for program, found, bounds in part(work):
                    progress(
                        f"{case.name}, {program}: " + ", ".join(f"{k} {v:.4g}" for k, v in found.items())
                    )
                    figures |= {f"{case.name}_{program}_{key}": value for key, value in found.items()}
                    limits |= {f"{case.name}_{program}_{key}": bound for key, bound in bounds.items()}
            seconds[case.name] = time.perf_counter() - start
            jax.clear_caches()
    finish("exchange", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
