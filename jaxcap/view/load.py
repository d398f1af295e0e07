"""Load the contents of a window from files: every kind that `jaxcap info` knows, and the folders of runs and
scans."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..errors import InputError, user_message
from ..io.archives.archive import array_names, read_format_name
from ..io.archives.checkpoint import FORMAT as CHECKPOINT
from ..io.archives.checkpoint import load_progress
from ..io.archives.limits import FORMAT as LIMITS
from ..io.archives.npz import load_body, load_motion
from ..io.archives.prior import FORMAT as PRIOR
from ..io.archives.run_statistics import read_statistics
from ..io.cameras import read_cameras
from ..io.constraints import FORMAT as CONSTRAINTS
from ..io.kinds import kind_of_arrays, kind_of_json, wrong_kind_error
from ..io.markers.subject import FORMAT as SUBJECT
from ..io.markers.subject import load_subject
from ..io.meshes.clouds import read_clouds
from ..io.meshes.mesh import SUFFIXES, read_mesh
from ..io.meshes.meshes import read_meshes
from ..io.registry import (
    MARKER_READERS,
    MOTION_READERS,
    SKELETON_READERS,
    SKINNED_READERS,
    default_clip_message,
    is_skinned,
    read_marker_file,
    read_motion,
    read_skeleton,
    read_skinned,
)
from ..io.skeletons.amass import has_other_shape, is_amass
from ..io.skeletons.body_motion import read_body_motion
from ..io.skinned.clip import split_clip, suffix_of
from ..io.text import read_json
from ..markers.subject import Subject
from .contents import Contents, Markers, Meshes, Take, make_take
from .figures.clouds import DisplayClouds
from .live import JOURNAL, follow_run

#: files of numbers without a shape, and the command that describes each
ADVICE_BY_KIND = {
    LIMITS: "this file contains joint limits; `jaxcap info` describes them, and `jaxcap limits check` tests a motion "
    "against them",
    PRIOR: "this file contains a pose prior; `jaxcap info` describes it",
}
#: the same by suffix
ADVICE_BY_SUFFIX = {
    **dict.fromkeys((".html", ".svg"), "this is a report; open it in a browser"),
    ".png": "this is a picture; `jaxcap view --depth FILES --cameras CAMERAS.json` shows depth images",
    ".cst": "this file contains joint limits; give it to a command by --limits",
    ".vj": "this file assigns vertices to joints; give the mesh next to it by --body",
    ".csv": "this file contains the statistics of a run; give the folder of the run",
}


def load(
    files: Sequence[str],
    bodies: Sequence[tuple[str, Body]] = (),
    clouds: Sequence[str] = (),
    *,
    unit: str | None = None,
    upright_rotation: Float[np.ndarray, "3 3"] | None = None,
    rate: float | None = None,
    follow: bool = False,
    shape: Callable[[str, Path], Body | None] | None = None,
) -> Contents:
    """Load files, folders and patterns.

    **Arguments:** `files`, as a user names them; `bodies` by name, each applied to every motion of its
    skeleton; `shape`, the body of such a name in the shape of a motion, None if it has no shape of its own; `clouds`, sources that hold only scans; `unit` of lengths if a file has none; `upright_rotation
    (3, 3)` of scans and meshes; `rate` of an unfinished run; `follow`, whether a run may not have begun yet,
    or resumes after a stop.

    **Raises:** `InputError` if a file is invalid, or a motion matches none of the given bodies.
    """
    return _Loader(list(bodies), unit, upright_rotation, rate, follow, shape).load(files, clouds)


class _Loader:
    """The contents found so far. Motions are loaded last, as their bodies may be named after them."""

    def __init__(self, bodies, unit: str | None, turn, rate: float | None, follow: bool, shape):
        self.bodies: list[tuple[str, Body]] = bodies
        self.unit, self.turn, self.rate, self.follow, self.shape = unit, turn, rate, follow, shape
        self.contents = Contents()
        self.motions: list[Path] = []
        self.subjects: list[tuple[str, Subject]] = []
        self.skeletons: list[tuple[str, Skeleton]] = []
        self.runs: list[Path] = []
        #: ids of the bodies, subjects and skeletons that have a motion
        self.used_ids: set[int] = set()

    def load(self, files: Sequence[str], clouds: Sequence[str]) -> Contents:
        for name in files:
            self.take(name)
        for source in clouds:
            self.clouds(source)
        for path in self.motions:
            self.contents.takes.append(self.motion_take(path))
        for folder in self.runs:
            self.contents.takes.append(self.run_take(folder))
        rest = [make_take(name, body.skeleton, body) for name, body in self.without_motion(self.bodies)]
        rest += [
            make_take(name, subject.skeleton, subject=subject)
            for name, subject in self.without_motion(self.subjects)
        ]
        rest += [make_take(name, skeleton) for name, skeleton in self.without_motion(self.skeletons)]
        self.contents.takes.extend(rest)
        return self.contents

    def without_motion(self, named: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        """Select the entries that have no motion yet."""
        return [(name, one) for name, one in named if id(one) not in self.used_ids]

    def sort_unused_first(self, named: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        """Sort the entries, those without a motion first: several equal ones get a motion each, in order."""
        return sorted(named, key=lambda pair: id(pair[1]) in self.used_ids)

    def take(self, name: str) -> None:
        path, suffix = Path(name), suffix_of(name)
        if path.is_dir() or (self.follow and not suffix and not path.exists()):
            self.folder(path)
        elif not split_clip(path)[0].is_file():
            self.clouds(name)
        elif suffix in (".npz", ".partial"):
            self.load_arrays(path)
        elif suffix == ".json":
            self.json(path)
        elif suffix in ADVICE_BY_SUFFIX and (suffix != ".csv" or path.name == "statistics.csv"):
            self.contents.notes.append(f"{path}: {ADVICE_BY_SUFFIX[suffix]}.")
        elif suffix in MARKER_READERS:
            self.contents.markers.append(Markers(path.name, read_marker_file(path, self.unit).frames))
        elif is_skinned(path):
            self.load_skinned(path)
        elif suffix in MOTION_READERS and suffix not in SUFFIXES:
            self.motions.append(path)
        elif suffix in SKELETON_READERS and suffix not in SUFFIXES:
            self.skeletons.append((path.name, read_skeleton(path, self.unit)))
        elif suffix in SUFFIXES:
            mesh = read_mesh(path, self.unit or "m")
            self.contents.meshes.append(
                Meshes(path.name, self.rotate_upright(mesh.vertices)[None], mesh.faces)
            )
        else:
            known = {
                *SUFFIXES,
                *SKINNED_READERS,
                *MOTION_READERS,
                *SKELETON_READERS,
                *MARKER_READERS,
                ".json",
            }
            raise wrong_kind_error(path, "a file to show", sorted(known))

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
            self.contents.cameras.extend(read_cameras(folder / "cameras.json"))
            if (folder / "truth.npz").is_file():
                self.motions.append(folder / "truth.npz")
            packed = folder / "clouds.npz"
            self.clouds(str(packed if packed.is_file() else folder))
        else:
            self.clouds(str(folder))

    def clouds(self, source: str) -> None:
        self.contents.clouds.append(DisplayClouds(read_clouds(source, unit=self.unit or "m"), self.turn))

    def load_arrays(self, path: Path) -> None:
        names = array_names(path)
        kind = read_format_name(path)
        if kind == "jaxcap body":
            self.bodies.append((path.name, load_body(path)))
        elif kind == "jaxcap motion" or kind_of_arrays(names, kind) == "amass":
            self.motions.append(path)
        elif kind == SUBJECT:
            self.subjects.append((path.name, load_subject(path)))
        elif kind == CHECKPOINT:
            body, motion = load_progress(path)
            self.contents.takes.append(make_take(path.name, body.skeleton, body, motion))
        elif kind in ADVICE_BY_KIND:
            self.contents.notes.append(f"{path}: {ADVICE_BY_KIND[kind]}.")
        elif "vertices" in names and {"faces", "face_counts"} & set(names):
            meshes = read_meshes(path, self.unit or "m")
            there = self.rotate_upright(np.asarray(meshes.vertices))
            self.contents.meshes.append(Meshes(path.name, there, np.asarray(meshes.faces), meshes.rate))
        elif {"points", "vertices"} & set(names):
            self.clouds(str(path))
        else:
            self.contents.notes.append(
                f"{path}: this file contains no geometry; its arrays are {', '.join(names[:8])}."
            )

    def load_skinned(self, path: Path) -> None:
        """Load a file that has a body with or without a motion."""
        body, motion = read_skinned(path)
        several = default_clip_message(path)
        if several is not None:
            self.contents.notes.append(several)
        if motion is None:
            self.bodies.append((path.name, body))
        else:
            self.contents.takes.append(make_take(path.name, body.skeleton, body, motion))

    def json(self, path: Path) -> None:
        content = read_json(path)
        if kind_of_json(content) == "cameras":
            self.contents.cameras.extend(read_cameras(path))
        elif isinstance(content, dict) and content.get("format") == CONSTRAINTS:
            self.contents.notes.append(
                f"{path}: this file contains constraints of a pose; `jaxcap ik --constraints` shows them."
            )
        else:
            self.contents.notes.append(
                f"{path}: this file contains no cameras; if it belongs to a run, give the folder of the run."
            )

    def motion_take(self, path: Path) -> Take:
        """Load the take of a motion, with the body or subject that it matches, otherwise with its own
        bones."""
        more = _statistics(path)
        # a run is named by its folder
        name = path.resolve().parent.name if more else path.name
        why: list[str] = []
        for body_name, body in self.sort_unused_first(self.bodies):
            try:
                shaped = self.shape(body_name, path) if self.shape else None
                own = body if shaped is None else shaped
                motion = read_body_motion(own, path, self.unit)
            except InputError as error:
                why.append(user_message(error))
                continue
            _check_frames(motion, path)
            if shaped is None and has_other_shape(path):
                self.contents.notes.append(
                    f"{path}: the shape of this motion (betas) is not applied to {body_name}."
                )
            self.used_ids.add(id(body))
            title = name if len(self.bodies) == 1 else f"{name} on {body_name}"
            return make_take(title, own.skeleton, own, motion, **more)
        if is_amass(path) and not self.bodies:
            self.contents.notes.append(
                f"{path}: the bones of this motion are shown; give its body model by --body for the surface of the person."
            )
        given = ", ".join(body_name for body_name, _ in self.bodies)
        bare = path.suffix.lower() == ".npz" and "names" not in array_names(path) and not is_amass(path)
        try:
            skeleton, motion = self.skeleton_of(path, why) if bare else read_motion(path, self.unit)
        except InputError as error:
            # a file of AMASS has no bones, so the reason why no body fits is the only remedy
            if not why or bare:
                raise
            raise InputError(f"{path}: {_without_path(why[0], path)}") from error
        _check_frames(motion, path)
        if why:
            self.contents.notes.append(
                f"{path}: this motion does not fit {given}, so its own bones are shown: {_without_path(why[0], path)}"
            )
        for kind in (self.subjects, self.skeletons):
            for _, one in self.sort_unused_first(kind):
                there = one.skeleton if isinstance(one, Subject) else one
                if there.names == skeleton.names:
                    self.used_ids.add(id(one))
                    subject = one if isinstance(one, Subject) else None
                    return make_take(
                        name, there if subject else skeleton, motion=motion, subject=subject, **more
                    )
        return make_take(name, skeleton, motion=motion, **more)

    def skeleton_of(self, path: Path, why: list[str]) -> tuple[Skeleton, Motion]:
        """Load a motion without a skeleton for one that was given. Raises `InputError` if none fits."""
        given = [name for name, _ in self.bodies]
        for name, one in self.sort_unused_first([*self.subjects, *self.skeletons]):
            skeleton = one.skeleton if isinstance(one, Subject) else one
            try:
                return skeleton, load_motion(path, skeleton)
            except InputError as error:
                given.append(name)
                why.append(user_message(error))
        hint = (
            f", and it does not fit {', '.join(given)}: {_without_path(why[0], path)}"
            if why
            else "; give its body by --body."
        )
        raise InputError(f"{path}: this motion file has no skeleton{hint}")

    def run_take(self, folder: Path) -> Take:
        """Load the take of an unfinished run."""
        if not self.bodies:
            raise InputError(
                f"{folder}: this run is not finished, and its journal does not name its body; give the body of the run "
                "by --body."
            )
        why = []
        for _, body in self.sort_unused_first(self.bodies):
            try:
                taken = follow_run(folder, body, self.rate or 30.0)
            except InputError as error:
                why.append(error)
            else:
                self.used_ids.add(id(body))
                return taken
        raise why[0]

    def rotate_upright(self, vertices: np.ndarray) -> np.ndarray:
        return vertices if self.turn is None else vertices @ self.turn.T


def _check_frames(motion: Motion, path: Path) -> None:
    if not len(motion):
        raise InputError(f"{path}: there are no frames in this motion.")


def _without_path(why: str, path: Path) -> str:
    return why.removeprefix(f"{path}: ")


def _statistics(path: Path) -> dict[str, Any]:
    """Read the statistics of each frame from the file next to a run's motion, if there is one."""
    beside = path.with_name("statistics.json")
    if path.name != "motion.npz" or not beside.is_file():
        return {}
    return read_statistics(beside)._asdict()
