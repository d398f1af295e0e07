"""Text descriptions of markers, JSON, tables and Kineben's files."""

from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.angle_table import read_angle_names
from ...io.archives.journal import read_header, read_records
from ...io.cameras import read_cameras
from ...io.depth.camera_keys import ACCEPTED
from ...io.kinds import kind_of_json
from ...io.registry import read_marker_file, read_skeleton
from ...io.skeletons.asf import read_asf
from ...io.skeletons.cst import read_cst
from ...io.skeletons.joint_names import read_joint_names
from ...io.system.reader_errors import reader_of
from ...io.text import Words, numbered_lines, parse_json, read_json, read_text
from ..console.console import pluralise, say
from ..markers.subject_files import print_subjects
from .bodies import describe_skeleton


def describe_markers(path: Path, unit: str | None) -> str:
    """Print the number of markers and the length of a marker file, or the number of angles of a table of joint angles."""
    angles = read_angle_names(path) if path.suffix.lower() == ".csv" else None
    if angles is not None:
        say(
            f"joint angles: {len(angles)}, in degrees ({', '.join(angles[:6])}{', ...' if len(angles) > 6 else ''})"
        )
        return "joint angles"
    file = read_marker_file(path, unit)
    frames = file.frames
    count, shown = len(frames), 100 * float(np.asarray(frames.visible).mean())
    say(
        f"markers: {len(frames.labels)}, {pluralise(count, 'frame')} at {frames.rate:g} frames per second, {count / frames.rate:.2f} s, unit "
        f"{file.unit}, {shown:.3g} % seen"
    )
    print_subjects(frames)
    return "markers"


@reader_of("a JSON file")
def describe_json(path: Path) -> str:
    """Print a description of a JSON file, and return its kind."""
    content = read_json(path)
    kind = kind_of_json(content)
    if kind == "cameras":
        cameras = read_cameras(path)
        sizes = ", ".join(dict.fromkeys(f"{camera.width} x {camera.height}" for camera in cameras))
        say(f"cameras: {len(cameras)} of {sizes} pixels")
    elif kind == "constraints":
        rows = content["constraints"]
        count = len(rows) if isinstance(rows, list) else 0
        of = f" for a body of {content['vertices']} vertices" if "vertices" in content else ""
        say(f"constraints: {count}{of}")
    elif kind == "statistics":
        describe_statistics(path)
    elif kind == "keys":
        say(f"keys: {len(content['joints'])} joints, {content.get('frames', 0)} frames")
    elif kind == "joint names":
        names = list(read_joint_names(path).values())
        say(
            f"table of joints: {len(names) - names.count(None)} that match, {names.count(None)} without a match"
        )
    elif kind == "json" and not (isinstance(content, dict) and content):
        raise InputError(f"{path}: no verb reads this JSON file. Of cameras: {ACCEPTED}.")
    else:
        what = "settings of a scan" if kind == "scan" else "a JSON file with the keys"
        say(f"{what}: {', '.join(map(str, content))[:300]}")
    return kind


def describe_statistics(path: Path) -> None:
    """Print a summary of a tracking run from its statistics, `.json` or `.csv`. Raises `InputError`."""
    text = read_text(path)
    try:
        if path.suffix.lower() == ".json":
            verdicts = [row["verdict"] for row in parse_json(text, path)["frames"]]
        else:
            head, *rows = (line.split(",") for line in text.splitlines() if line.strip())
            verdicts = [row[head.index("verdict")] for row in rows]
    except (ValueError, KeyError, TypeError, IndexError):
        raise InputError(f"{path}: these are not the statistics of a run; remove the file.") from None
    say(f"statistics: {pluralise(len(verdicts), 'frame')}, {verdicts.count('lost')} lost")


def describe_journal(path: Path) -> str:
    """Print the progress of a run that was stopped."""
    header, records = read_header(path), read_records(path)
    joints = header.get("joints")
    of = f" of {len(joints)} joints" if isinstance(joints, list) else ""
    say(f"journal: {len(records)} frames{of} are complete")
    return "journal"


def describe_kineben(path: Path, unit: str | None) -> str:
    """Print a description of a Kineben file; limits are read with the skeleton in their folder."""
    kind = path.suffix.lower()[1:]
    if kind == "skl":
        describe_skeleton(read_skeleton(path, unit))
    elif kind == "vj":
        names = [line.strip() for line in read_text(path).splitlines() if line.strip()]
        say(f"parts: {len(names)} vertices on {len(set(names))} joints")
    else:
        count, skeleton = Words(path).header("KBCST"), path.with_suffix(".skl")
        if skeleton.is_file():
            read_cst(path, read_skeleton(skeleton, unit))
        say(f"limits: {count} joints{', skeleton ' + str(skeleton) if skeleton.is_file() else ''}")
    return kind


def describe_asf(path: Path) -> str:
    """Print a description of an `.asf`."""
    asf = read_asf(path)
    describe_skeleton(asf.skeleton)
    say(f"limits: {len(asf.boxes.joints)} joints")
    return "asf"


@reader_of("a list")
def describe_text(path: Path) -> str:
    """Print a description of a list in a text file. Raises `InputError` if it is none."""
    rows = [line.split() for _, line in numbered_lines(read_text(path))]
    widths = {len(row) for row in rows}
    if rows and widths <= {1, 2} and all(row[-1].isdecimal() for row in rows):
        say(f"vertices: {len(rows)} with their names")
        return "vertices"
    if rows and widths <= {2, 3}:
        say(f"pairs of words: {len(rows)}, the first is {' '.join(rows[0])[:80]}")
        return "pairs"
    raise InputError(
        f"{path}: this text file is not a list of names and vertices, of markers and segments, or of pairs of joints; "
        "expected one entry per line."
    )
