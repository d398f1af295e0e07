"""The suggested next command for each kind of content."""

from pathlib import Path

from ...io.depth.camera_keys import ACCEPTED
from .depth import NOBODY, NOT_METRES, DepthOptions
from .folders import first_file_of_kind

#: of depth images, where none were given
NO_OPTIONS = DepthOptions()
_DEPTH = (
    (
        "track human --depth {file} --cameras {cameras}{depth_scale} -o tracked",
        "fits a body{if_known}",
    ),
    ("view --depth {file} --cameras {cameras}{depth_scale}", "shows how the person is found"),
)
#: commands for each kind of content, with `{file}` in place of its name, and their purposes
COMMANDS: dict[str, tuple[tuple[str, str], ...]] = {
    "body": (("track {file} CLOUDS -o tracked", "fits it to clouds"), ("view {file}", "shows it")),
    "body model": (
        ("fit {file} MESHES -o fit.npz", "fits its coefficients and poses to registered meshes"),
        ("track {file} CLOUDS --fit-shape -o tracked", "fits its coefficients and poses to clouds"),
        ("convert MOTION.npz motion.glb --body {file}", "applies a motion in AMASS format"),
    ),
    "skinned": (
        ("track {file} CLOUDS -o tracked", "fits it to clouds"),
        ("convert {file} body.npz --as body", "saves it as a body"),
    ),
    "rigged": (
        ("track {file} CLOUDS -o tracked", "fits it to clouds"),
        ("convert {file} body.npz --as body", "saves it as a body"),
        ("convert {file} body.glb", "exports it to other programs"),
    ),
    "animated": (
        ("edit retarget {file} human -o human.npz", "retargets its motion to the human"),
        ("track {file} CLOUDS -o tracked", "fits its body to clouds"),
    ),
    "motion": (
        ("view {file}", "shows it"),
        ("edit retarget {file} human -o human.npz", "retargets it to the human"),
    ),
    "motion of a body": (
        ("convert {file} motion.glb --body BODY", "writes it with its body"),
        ("convert {file} motion.bvh --body BODY", "adds the skeleton of its body"),
    ),
    "subject": (("markers solve {file} TRIAL.c3d -o motion.bvh", "solves for the motion in a trial"),),
    "limits": (("limits check MOTION -l {file}", "reports where a motion violates them"),),
    "prior": (
        ("prior info {file}", "describes it in detail"),
        ("adapt human CLOUDS -o actor.npz --prior {file}", "adapts a body with it"),
    ),
    "checkpoint": (
        ("learn MESHES -o {stem} --resume", "continues the run, with the options that it began with"),
    ),
    "meshes": (
        ("learn {file} -o body.npz", "learns a body"),
        ("fit BODY {file} -o motion.npz", "fits the poses of a body"),
    ),
    "clouds": (("track human {file} -o tracked", "fits a body"),),
    "joints": (("evaluate BODY MOTION CLOUDS --truth {file}", "compares a motion with them"),),
    "mesh": (
        ("rig {file} -o body.npz", "makes a body of it"),
        ("track human {file} -o tracked", "fits a body to it, if it is a scan"),
    ),
    "cloud": (("track human {file} -o tracked", "fits a body"),),
    "depth": _DEPTH,
    "folder of depth": _DEPTH,
    "depth recording": (
        ("track human --depth {file}{other_cameras}{depth_scale} -o tracked", "fits a body"),
        ("view --depth {file}{other_cameras}{depth_scale}", "shows how the person is found"),
    ),
    "asf": (("limits check MOTION.amc -l {file}", "reports where a motion violates its limits"),),
    "osim": (
        ("markers solve {file} TRIAL.trc -o angles.mot", "solves for its coordinates in a trial"),
        ("convert ANGLES.mot motion.bvh --body {file}", "converts its coordinates to a motion"),
    ),
    "osim without markers": (
        ("convert ANGLES.mot motion.bvh --body {file}", "converts its coordinates to a motion"),
    ),
    "storage": (
        ("convert {file} motion.bvh --body MODEL.osim", "converts coordinates to a motion of their model"),
    ),
    "skl": (("rig MESH -o body.npz --skeleton {file}", "binds a mesh to it"),),
    "cst": (("track MESH CLOUDS -o tracked --limits {file}", "enforces these limits"),),
    "vj": (("track MESH CLOUDS -o tracked --vj {file}", "uses these joints of the vertices"),),
    "markers": (
        ("markers info {file}", "lists their gaps"),
        ("markers fit {file} -o subject.npz", "calibrates a subject"),
    ),
    "statistics": (("view {folder}", "shows the run"),),
    "cameras": (
        ("track human --depth IMAGES --cameras {file} -o tracked", "fits a body to depth images"),
        ("adapt human CLOUDS -o actor.npz --cameras {file}", "uses them for visibility"),
    ),
    "constraints": (("ik human --constraints {file} -o pose.npz", "solves for the pose"),),
    "scan": (("info {folder}", "describes the scans"),),
    "vertices": (
        (
            "convert motion.npz markers.c3d --body body.npz --vertices {file}",
            "writes their paths as markers",
        ),
    ),
    "pairs": (
        ("markers fit TAKES -o subject.npz --segments {file}", "if they are markers and segments"),
        (
            "edit retarget MOTION TARGET -o motion.bvh --names {file}",
            "if they are joints of two skeletons",
        ),
    ),
    "joint names": (("edit retarget MOTION TARGET -o motion.bvh --names {file}", "matches joints by it"),),
    "journal": (("track BODY CLOUDS -o {folder} --resume", "continues the run"),),
    "unfinished": (
        ("track BODY CLOUDS -o {file} --resume", "continues the run"),
        ("view {file} --body BODY", "shows its progress"),
    ),
    "run": (("view {file}", "shows it"), ("evaluate BODY {file}/motion.npz CLOUDS", "measures its errors")),
    "scans": (("track human {file} -o tracked", "fits a body"), ("view {file}", "shows them")),
    "depth scans": (
        (
            "track human --depth {file}/depth0 --cameras {file}/cameras.json{depth_scale} -o tracked",
            "fits a body to one camera's images",
        ),
        (
            "view --depth {file}/depth0 --cameras {file}/cameras.json{depth_scale}",
            "shows how the person is found, if there is one camera",
        ),
    ),
    "folder of markers": (("markers fit {file}/* -o subject.npz", "calibrates a subject"),),
    "folder of bvh": (("prior learn {file}/*.bvh -o prior.npz", "learns a pose prior"),),
    "folder of amc": (("prior learn {file}/*.amc -o prior.npz", "learns a pose prior"),),
}
#: prefix of the kinds of folders
FOLDER_PREFIX = "folder of "
#: sentences about kinds that no verb reads
NO_COMMAND_SENTENCES = {
    "arrays": "no verb reads these arrays; clouds need an array points (F, N, 3), meshes need vertices (F, V, 3) and "
    "faces (T, 3)",
    "json": f"no verb reads this JSON file; if it is of cameras: {ACCEPTED}",
    "joint angles": "no verb reads joint angles; they are for other programs",
    "keys": "no verb reads keys; they are for other programs",
    NOBODY: "no person was found: check --depth-scale ({scale} units in a metre were used; depths that are no whole numbers "
    "are in metres) and --cameras ({cameras_used}), or give these images as --empty if they show nobody",
    NOT_METRES: "no command is suggested, as depths that are no whole numbers have to be in metres: convert them",
    "picture": "no verb reads pictures or pages; open it in a browser",
}


def suggest_commands(kind: str, file: str, unit: str | None = None, depth: DepthOptions = NO_OPTIONS) -> str:
    """Return a line with the suggested commands for a file of some kind, or a sentence about its use.

    **Arguments:** `unit` of lengths, if the commands need it; `depth`, the options of depth images, which are repeated.
    """
    if kind not in COMMANDS and kind.startswith(FOLDER_PREFIX):
        one = first_file_of_kind(Path(file), kind.removeprefix(FOLDER_PREFIX))
        return (
            suggest_commands("other", file)
            if one is None
            else f"next: `jaxcap info {_quoted(str(one))}` describes one of them"
        )
    cameras = "" if depth.cameras is None else _quoted(str(depth.cameras))
    words = {
        "file": _quoted(file),
        "folder": _quoted(str(Path(file).parent)),
        "stem": _quoted(file.removesuffix(".partial")),
        "cameras": cameras or "CAMERAS.json",
        "cameras_used": cameras or "the one in the recording",
        "if_known": "" if cameras else ", given the intrinsics of the camera",
        "scale": f"{depth.scale:.12g}",
        "other_cameras": cameras and f" --cameras {cameras}",
        "depth_scale": "" if depth.scale == 1000 else f" --depth-scale {depth.scale:.12g}",
    }
    if kind not in COMMANDS:
        return NO_COMMAND_SENTENCES.get(kind, "no verb reads this").format(**words)
    ending = "" if unit is None else f" --unit {unit}"
    return "next: " + "; ".join(
        f"`jaxcap {line.format(**words)}{ending}` {what.format(**words)}" for line, what in COMMANDS[kind]
    )


def _quoted(word: str) -> str:
    return f"'{word}'" if any(sign in word for sign in " *?[|;&()") else word
