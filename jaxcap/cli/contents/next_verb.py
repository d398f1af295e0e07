"""The suggested next command for each kind of content."""

from pathlib import Path

from .folders import first_of

#: commands for each kind of content, with `{file}` in place of its name, and their purposes
COMMANDS: dict[str, tuple[tuple[str, str], ...]] = {
    "body": (("track {file} CLOUDS -o tracked", "fits it to clouds"), ("view {file}", "shows it")),
    "skinned": (
        ("track {file} CLOUDS -o tracked", "fits it to clouds"),
        ("convert {file} body.npz --as body", "keeps it as a body"),
    ),
    "rigged": (
        ("track {file} CLOUDS -o tracked", "fits it to clouds"),
        ("convert {file} body.npz --as body", "keeps it as a body"),
        ("convert {file} body.glb", "gives it to other programs"),
    ),
    "animated": (
        ("edit retarget {file} human -o human.npz", "gives its motion to the human"),
        ("track {file} CLOUDS -o tracked", "fits its body to clouds"),
    ),
    "motion": (
        ("view {file}", "shows it"),
        ("edit retarget {file} human -o human.npz", "gives it to the human"),
    ),
    "motion of a body": (("convert {file} motion.bvh --body BODY", "gives it the skeleton of its body"),),
    "subject": (("markers solve {file} TRIAL.c3d -o motion.bvh", "finds the motion of a trial"),),
    "limits": (("limits check MOTION -l {file}", "says where a motion is beyond them"),),
    "prior": (
        ("prior info {file}", "says more"),
        ("adapt human CLOUDS -o actor.npz --prior {file}", "uses it"),
    ),
    "checkpoint": (
        ("learn MESHES -o {stem} --resume", "goes on with the run, with the words it was begun with"),
    ),
    "meshes": (("learn {file} -o body.npz", "learns a body"), ("fit BODY {file} -o motion.npz", "poses one")),
    "clouds": (("track human {file} -o tracked", "fits a body"),),
    "joints": (("evaluate BODY MOTION CLOUDS --truth {file}", "compares a motion with them"),),
    "mesh": (("rig {file} -o body.npz", "makes it a body"),),
    "cloud": (("track human {file} -o tracked", "fits a body"),),
    "asf": (("limits check MOTION.amc -l {file}", "says where a motion is beyond its limits"),),
    "skl": (("rig MESH -o body.npz --skeleton {file}", "binds a mesh to it"),),
    "cst": (("track MESH CLOUDS -o tracked --cst {file}", "keeps these limits"),),
    "vj": (("track MESH CLOUDS -o tracked --vj {file}", "moves the vertices of a mesh so"),),
    "markers": (
        ("markers info {file}", "says where gaps are"),
        ("markers fit {file} -o subject.npz", "finds the skeleton in them"),
    ),
    "statistics": (("view {folder}", "shows the run"),),
    "cameras": (("adapt human CLOUDS -o actor.npz --cameras {file}", "knows what they see"),),
    "constraints": (("ik human --constraints {file} -o pose.npz", "finds the pose"),),
    "scan": (("info {folder}", "says what the scans are"),),
    "vertices": (
        (
            "convert motion.npz markers.c3d --body body.npz --vertices {file}",
            "writes their paths",
        ),
    ),
    "pairs": (
        ("markers fit TAKES -o subject.npz --segments {file}", "where they are markers and segments"),
        (
            "edit retarget MOTION TARGET -o motion.bvh --names {file}",
            "where they are joints of two skeletons",
        ),
    ),
    "joint names": (
        ("edit retarget MOTION TARGET -o motion.bvh --names {file}", "takes the joints that match from it"),
    ),
    "journal": (("track BODY CLOUDS -o {folder} --resume", "goes on with the run"),),
    "unfinished": (
        ("track BODY CLOUDS -o {file} --resume", "goes on with the run"),
        ("view {file} --body BODY", "shows how far it is"),
    ),
    "run": (("view {file}", "shows it"), ("evaluate BODY {file}/motion.npz CLOUDS", "measures it")),
    "scans": (("track human {file} -o tracked", "fits a body"), ("view {file}", "shows them")),
    "folder of markers": (("markers fit {file}/* -o subject.npz", "finds the skeleton in them"),),
    "folder of bvh": (("prior learn {file}/*.bvh -o prior.npz", "learns which poses are likely"),),
    "folder of amc": (("prior learn {file}/*.amc -o prior.npz", "learns which poses are likely"),),
}
#: prefix of the kinds of folders
FOLDER = "folder of "
#: sentences about kinds that no verb reads
OTHERS = {
    "arrays": "no verb reads these arrays; clouds are an array points (F, N, 3), meshes vertices (F, V, 3) with faces (T, 3)",
    "report": "no verb reads a report; it is for other programs",
    "keys": "no verb reads keys; they are for other programs",
    "picture": "no verb reads pictures or pages; open it in a browser",
}


def next_verbs(kind: str, file: str, unit: str | None = None) -> str:
    """Return a line with the suggested commands for a file of some kind, or a sentence about its use.

    **Arguments:** `unit` of lengths, if the commands need it.
    """
    if kind not in COMMANDS and kind.startswith(FOLDER):
        one = first_of(Path(file), kind.removeprefix(FOLDER))
        return (
            next_verbs("other", file)
            if one is None
            else f"next: `jaxcap info {_quoted(str(one))}` says more of one of them"
        )
    if kind not in COMMANDS:
        return OTHERS.get(kind, "no verb reads this")
    words = {
        "file": _quoted(file),
        "folder": _quoted(str(Path(file).parent)),
        "stem": _quoted(file.removesuffix(".partial")),
    }
    ending = "" if unit is None else f" --unit {unit}"
    return "next: " + "; ".join(
        f"`jaxcap {line.format(**words)}{ending}` {what}" for line, what in COMMANDS[kind]
    )


def _quoted(word: str) -> str:
    return f"'{word}'" if any(sign in word for sign in " *?[|;&()") else word
