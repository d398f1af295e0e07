"""The meshes of several people as arguments name them: a folder, a file or a named part of a pattern for each person."""

import glob
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError
from ...io.meshes.mesh import SUFFIXES
from ...io.meshes.meshes import read_mesh_groups
from ...io.system.paths import find_files, natural_sort_key
from ...observe.meshes import MeshSequence
from ..batch.patterns import FOLDER, INPUT, NAMED, STEM, match_pattern

#: names of parts of a pattern that name the person, if there are several parts
_PERSON_PARTS = ("subject", "person")


def names_people(sources: Sequence[str]) -> bool:
    """Test if one of the sources is a pattern with a named part, such as `meshes/{subject}/*.ply`."""
    return any(NAMED.search(source) and not Path(source).exists() for source in sources)


def find_people(sources: Sequence[str]) -> dict[str, list[str]]:
    """Find the sources of the meshes of each person, by name.

    An `.npz` has the name of the file, and mesh files that of their folder: so a folder is one person, and so are all the files of
    a folder. A pattern with a named part has the text of this part.

    **Raises:** `InputError` if nothing is found, two places have the same name, or a pattern does not say which part names the
    person.
    """
    people: dict[str, list[str]] = {}
    places: dict[str, str] = {}
    for source in sources:
        for name, place, file in _persons_of(source):
            if places.setdefault(name, place) != place:
                raise InputError(
                    f"{source}: two people are called {name}, in {places[name]} and {place}; rename one of them."
                )
            people.setdefault(name, []).append(str(Path(file)))
    return people


def _persons_of(source: str) -> list[tuple[str, str, str]]:
    """List the name of the person, the place that it stands for, and the file of each mesh file of a source."""
    if names_people([source]):
        return _persons_of_pattern(source)
    if glob.has_magic(source) and not Path(source).exists():
        matches = sorted(map(Path, glob.glob(source)), key=natural_sort_key)
        if any(path.is_dir() for path in matches):
            return [row for path in matches for row in _persons_of(str(path))]
    _check_no_subfolders(Path(source))
    rows = []
    for path in find_files(source, check_gaps=False, extra_suffixes=(".npz",)):
        alone = path.suffix.lower() == ".npz"
        name = path.stem if alone else path.absolute().parent.name
        rows.append((name, str(path) if alone else str(path.parent), str(path)))
    return rows


def _check_no_subfolders(folder: Path) -> None:
    """Check that a folder, which is one person, has no folders with meshes, which would be others. Raises `InputError`."""
    inner = sorted(path for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    suffixes = (*SUFFIXES, ".npz")
    found = [file for path in inner for file in path.iterdir() if file.suffix.lower() in suffixes]
    if found:
        raise InputError(
            f"{folder}: this folder is one person, and contains folders with meshes, such as {found[0].parent}; if each of them is a "
            f'person, give "{folder}/*" or "{folder}/{{subject}}/*{found[0].suffix}", and else "{folder}/*{found[0].suffix}".'
        )


def _persons_of_pattern(pattern: str) -> list[tuple[str, str, str]]:
    parts = list(dict.fromkeys(NAMED.findall(pattern)))
    named = [name for name in _PERSON_PARTS if name in parts]
    if not named and len(parts) > 1:
        raise InputError(
            f"{pattern}: the parts {', '.join(parts)} have names, and none of them names the person; call that part {{subject}}."
        )
    part = named[0] if named else parts[0]
    if part in (INPUT, STEM, FOLDER):
        raise InputError(
            f"{pattern}: the name '{part}' is that of the file itself; call the part {{subject}}."
        )
    return [(values[part], pattern, values[INPUT]) for values in match_pattern(pattern)]


def read_people(
    sources: Sequence[str], unit: str, rate: float | None
) -> tuple[dict[str, MeshSequence], dict[str, tuple[str, ...]]]:
    """Read the meshes of each person, and the names of the meshes. Raises `InputError`, for several topologies, too."""
    people = find_people(sources)
    if len(people) == 1:
        (name, files), *_ = people.items()
        suffix = Path(files[0]).suffix
        raise InputError(
            f"{sources[0]}: there is one person, {name}, in the meshes, and a shape space is of several; the mesh files of a folder are "
            "one person. Give a folder or an .npz for each; if names of files state the person, give a pattern with this part, such as "
            f'"{Path(files[0]).parent}/{{subject}}_*{suffix}"; or learn one body, without --people.'
        )
    groups = read_mesh_groups(list(people.values()), unit, rate)
    return (
        {name: group.sequence for name, group in zip(people, groups, strict=True)},
        {name: group.names for name, group in zip(people, groups, strict=True)},
    )
