"""Load the contents of a window from files: every kind that `jaxcap info` knows, and the folders of runs and
scans."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..errors import InputError, sentence_of
from ..io.archives.archive import array_names, kind_of
from ..io.archives.checkpoint import KIND as CHECKPOINT
from ..io.archives.checkpoint import load_progress
from ..io.archives.limits import KIND as LIMITS
from ..io.archives.npz import load_body, load_motion
from ..io.archives.prior import KIND as PRIOR
from ..io.archives.run_statistics import read_statistics
from ..io.cameras import read_cameras
from ..io.constraints import KIND as CONSTRAINTS
from ..io.kinds import wrong_kind
from ..io.markers.subject import KIND as SUBJECT
from ..io.markers.subject import load_subject
from ..io.meshes.clouds import read_clouds
from ..io.meshes.mesh import SUFFIXES, read_mesh
from ..io.meshes.meshes import read_meshes
from ..io.registry import (
    MARKER_READERS,
    MOTION_READERS,
    SKELETON_READERS,
    SKINNED_READERS,
    clip_sentence,
    is_skinned,
    read_marker_file,
    read_motion,
    read_skeleton,
    read_skinned,
)
from ..io.skeletons.body_motion import read_motion_of
from ..io.skinned.clip import split_clip, suffix_of
from ..io.text import read_json
from ..markers.subject import Subject
from .contents import Contents, Markers, Meshes, Take, make_take
from .figures.clouds import SeenClouds
from .live import JOURNAL, follow_run

#: files of numbers without a shape, and the command that describes each
SHAPELESS = {
    LIMITS: "this file contains joint limits; `jaxcap info` describes them, and `jaxcap limits check` tests a motion "
    "against them",
    PRIOR: "this file contains a pose prior; `jaxcap info` describes it",
}
#: the same by suffix
OTHERS = {
    **dict.fromkeys((".html", ".png", ".svg"), "this is a report; open it in a browser"),
    ".cst": "this file contains joint limits; give it to a command by --cst",
    ".vj": "this file assigns vertices to joints; give the mesh next to it by --body",
    ".csv": "this file contains the statistics of a run; give the folder of the run",
}


def load(
    files: Sequence[str],
    bodies: Sequence[tuple[str, Body]] = (),
    clouds: Sequence[str] = (),
    *,
    unit: str | None = None,
    turn: Float[np.ndarray, "3 3"] | None = None,
    rate: float | None = None,
    follow: bool = False,
) -> Contents:
    """Load files, folders and patterns.

    **Arguments:** `files`, as a user names them; `bodies` by name, each applied to every motion of its
    skeleton; `clouds`, sources that hold only scans; `unit` of lengths if a file has none; `turn (3, 3)`, the
    rotation of scans and meshes to upright; `rate` of an unfinished run; `follow`, whether a run may not have
    begun yet, or resumes after a stop.

    **Raises:** `InputError` if a file is invalid, or a motion matches none of the given bodies.
    """
    return _Loader(list(bodies), unit, turn, rate, follow).load(files, clouds)


class _Loader:
    """The contents found so far. Motions are loaded last, as their bodies may be named after them."""

    def __init__(self, bodies, unit: str | None, turn, rate: float | None, follow: bool):
        self.bodies: list[tuple[str, Body]] = bodies
        self.unit, self.turn, self.rate, self.follow = unit, turn, rate, follow
        self.found = Contents()
        self.motions: list[Path] = []
        self.subjects: list[tuple[str, Subject]] = []
        self.skeletons: list[tuple[str, Skeleton]] = []
        self.runs: list[Path] = []
        #: ids of the bodies, subjects and skeletons that have a motion
        self.used: set[int] = set()

    def load(self, files: Sequence[str], clouds: Sequence[str]) -> Contents:
        for name in files:
            self.take(name)
        for source in clouds:
            self.clouds(source)
        for path in self.motions:
            self.found.takes.append(self.moving(path))
        for folder in self.runs:
            self.found.takes.append(self.running(folder))
        rest = [make_take(name, body.skeleton, body) for name, body in self.free(self.bodies)]
        rest += [
            make_take(name, subject.skeleton, subject=subject) for name, subject in self.free(self.subjects)
        ]
        rest += [make_take(name, skeleton) for name, skeleton in self.free(self.skeletons)]
        self.found.takes.extend(rest)
        return self.found

    def free(self, named: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        """Select the entries that have no motion yet."""
        return [(name, one) for name, one in named if id(one) not in self.used]

    def freest(self, named: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        """Sort the entries, those without a motion first: several equal ones get a motion each, in order."""
        return sorted(named, key=lambda pair: id(pair[1]) in self.used)

    def take(self, name: str) -> None:
        path, suffix = Path(name), suffix_of(name)
        if path.is_dir() or (self.follow and not suffix and not path.exists()):
            self.folder(path)
        elif not split_clip(path)[0].is_file():
            self.clouds(name)
        elif suffix in (".npz", ".partial"):
            self.arrays(path)
        elif suffix == ".json":
            self.json(path)
        elif suffix in OTHERS and (suffix != ".csv" or path.name == "statistics.csv"):
            self.found.told.append(f"{path}: {OTHERS[suffix]}.")
        elif suffix in MARKER_READERS:
            self.found.markers.append(Markers(path.name, read_marker_file(path, self.unit).frames))
        elif is_skinned(path):
            self.skinned(path)
        elif suffix in MOTION_READERS and suffix not in SUFFIXES:
            self.motions.append(path)
        elif suffix in SKELETON_READERS and suffix not in SUFFIXES:
            self.skeletons.append((path.name, read_skeleton(path, self.unit)))
        elif suffix in SUFFIXES:
            mesh = read_mesh(path, self.unit or "m")
            self.found.meshes.append(Meshes(path.name, self.upright(mesh.vertices)[None], mesh.faces))
        else:
            known = {
                *SUFFIXES,
                *SKINNED_READERS,
                *MOTION_READERS,
                *SKELETON_READERS,
                *MARKER_READERS,
                ".json",
            }
            raise wrong_kind(path, "a file to show", sorted(known))

    def folder(self, folder: Path) -> None:
        begun = (folder / JOURNAL).is_file()
        empty = not folder.exists() or not any(folder.iterdir())
        if self.follow and (begun or empty):
            self.runs.append(folder)
        elif (folder / "motion.npz").is_file():
            self.motions.append(folder / "motion.npz")
        elif begun:
            self.runs.append(folder)
        elif (folder / "cameras.json").is_file():
            self.found.cameras.extend(read_cameras(folder / "cameras.json"))
            if (folder / "truth.npz").is_file():
                self.motions.append(folder / "truth.npz")
            packed = folder / "clouds.npz"
            self.clouds(str(packed if packed.is_file() else folder))
        else:
            self.clouds(str(folder))

    def clouds(self, source: str) -> None:
        self.found.clouds.append(SeenClouds(read_clouds(source, unit=self.unit or "m"), self.turn))

    def arrays(self, path: Path) -> None:
        names = array_names(path)
        kind = kind_of(path)
        if kind == "jaxcap body":
            self.bodies.append((path.name, load_body(path)))
        elif kind == "jaxcap motion" or (not kind and "poses" in names):
            self.motions.append(path)
        elif kind == SUBJECT:
            self.subjects.append((path.name, load_subject(path)))
        elif kind == CHECKPOINT:
            body, motion = load_progress(path)
            self.found.takes.append(make_take(path.name, body.skeleton, body, motion))
        elif kind in SHAPELESS:
            self.found.told.append(f"{path}: {SHAPELESS[kind]}.")
        elif "vertices" in names and {"faces", "face_counts"} & set(names):
            meshes = read_meshes(path, self.unit or "m")
            there = self.upright(np.asarray(meshes.vertices))
            self.found.meshes.append(Meshes(path.name, there, np.asarray(meshes.faces), meshes.rate))
        elif {"points", "vertices"} & set(names):
            self.clouds(str(path))
        else:
            self.found.told.append(
                f"{path}: this file contains no geometry; its arrays are {', '.join(names[:8])}."
            )

    def skinned(self, path: Path) -> None:
        """Load a file that has a body with or without a motion."""
        body, motion = read_skinned(path)
        several = clip_sentence(path)
        if several is not None:
            self.found.told.append(several)
        if motion is None:
            self.bodies.append((path.name, body))
        else:
            self.found.takes.append(make_take(path.name, body.skeleton, body, motion))

    def json(self, path: Path) -> None:
        content = read_json(path)
        if isinstance(content, dict) and "cameras" in content:
            self.found.cameras.extend(read_cameras(path))
        elif isinstance(content, dict) and content.get("format") == CONSTRAINTS:
            self.found.told.append(
                f"{path}: this file contains constraints of a pose; `jaxcap ik --constraints` shows them."
            )
        else:
            self.found.told.append(
                f"{path}: this file contains no cameras; if it belongs to a run, give the folder of the run."
            )

    def moving(self, path: Path) -> Take:
        """Load the take of a motion, with the body or subject that it matches, otherwise with its own
        bones."""
        more = _statistics(path)
        # a run is named by its folder
        name = path.resolve().parent.name if more else path.name
        why: list[str] = []
        for body_name, body in self.freest(self.bodies):
            try:
                motion = read_motion_of(body, path, self.unit)
            except InputError as error:
                why.append(sentence_of(error))
                continue
            _check_frames(motion, path)
            self.used.add(id(body))
            title = name if len(self.bodies) == 1 else f"{name} on {body_name}"
            return make_take(title, body.skeleton, body, motion, **more)
        given = ", ".join(body_name for body_name, _ in self.bodies)
        bare = path.suffix.lower() == ".npz" and not {"names", "poses"} & set(array_names(path))
        skeleton, motion = self.skeleton_of(path, why) if bare else read_motion(path, self.unit)
        _check_frames(motion, path)
        if why:
            self.found.told.append(
                f"{path}: this motion does not fit {given}, so its own bones are shown: {_short(why[0], path)}"
            )
        for kind in (self.subjects, self.skeletons):
            for _, one in self.freest(kind):
                there = one.skeleton if isinstance(one, Subject) else one
                if there.names == skeleton.names:
                    self.used.add(id(one))
                    subject = one if isinstance(one, Subject) else None
                    return make_take(
                        name, there if subject else skeleton, motion=motion, subject=subject, **more
                    )
        return make_take(name, skeleton, motion=motion, **more)

    def skeleton_of(self, path: Path, why: list[str]) -> tuple[Skeleton, Motion]:
        """Load a motion without a skeleton for one that was given. Raises `InputError` if none fits."""
        given = [name for name, _ in self.bodies]
        for name, one in self.freest([*self.subjects, *self.skeletons]):
            skeleton = one.skeleton if isinstance(one, Subject) else one
            try:
                return skeleton, load_motion(path, skeleton)
            except InputError as error:
                given.append(name)
                why.append(sentence_of(error))
        hint = (
            f", and it does not fit {', '.join(given)}: {_short(why[0], path)}"
            if why
            else "; give its body by --body."
        )
        raise InputError(f"{path}: this motion file has no skeleton{hint}")

    def running(self, folder: Path) -> Take:
        """Load the take of an unfinished run."""
        if not self.bodies:
            raise InputError(
                f"{folder}: this run is not finished, and its journal does not name its body; give the body of the run "
                "by --body."
            )
        why = []
        for _, body in self.freest(self.bodies):
            try:
                taken = follow_run(folder, body, self.rate or 30.0)
            except InputError as error:
                why.append(error)
            else:
                self.used.add(id(body))
                return taken
        raise why[0]

    def upright(self, vertices: np.ndarray) -> np.ndarray:
        return vertices if self.turn is None else vertices @ self.turn.T


def _check_frames(motion: Motion, path: Path) -> None:
    if not len(motion):
        raise InputError(f"{path}: there are no frames in this motion.")


def _short(why: str, path: Path) -> str:
    return why.removeprefix(f"{path}: ")


def _statistics(path: Path) -> dict[str, Any]:
    """Read the statistics of each frame from the file next to a run's motion, if there is one."""
    beside = path.with_name("statistics.json")
    if path.name != "motion.npz" or not beside.is_file():
        return {}
    return read_statistics(beside)._asdict()
