"""Tables of matching joints of two skeletons, as JSON that a person can edit.

    {
     "format": "jaxcap joint names",
     "version": 1,
     "names": {
      "Pelvis": "Hips",
      "Weapon_R": null,
      "Bone_12": ""
     },
     "unmatched": ["LThumb"]
    }

`names` maps each joint of a source to one of a target, to null if it has no match, or to "" if its match is
unspecified. `unmatched` lists joints of the target without a source; it is for the human reader. A file may
also be the table alone.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...errors import InputError
from ..system.atomic import write_text
from ..system.reader_errors import reader_of
from ..text import read_text

FORMAT, VERSION = "jaxcap joint names", 1


def write_joint_names(
    path: str | Path, names: Mapping[str, str | None], unmatched: Sequence[str] = ()
) -> None:
    """Write a table of joints.

    **Raises:** `InputError` if the file cannot be written.
    """
    content = {"format": FORMAT, "version": VERSION, "names": dict(names), "unmatched": list(unmatched)}
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


@reader_of("a table of joints")
def read_joint_names(path: str | Path) -> dict[str, str | None]:
    """Read a table that `write_joint_names` or a person wrote; unspecified joints are left out.

    **Raises:** `InputError` if the file cannot be read, is no JSON, has another format or version, or if an
    entry does not map a name to a name, to null or to "".
    """
    text = read_text(path)
    twice: list[str] = []

    def pairs(items: list[tuple[str, object]]) -> dict[str, object]:
        seen: set[str] = set()
        for key, _ in items:
            if key in seen:
                twice.append(key)
            seen.add(key)
        return dict(items)

    try:
        content = json.loads(text, object_pairs_hook=pairs)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}:{error.lineno}: this is not JSON ({error.msg}); correct this line."
        ) from None
    except (ValueError, RecursionError):
        raise InputError(
            f"{path}: this JSON is nested too deeply or has numbers of too many digits; expected a table of joints."
        ) from None
    if twice:
        raise InputError(f"{path}: '{twice[0]}' occurs twice in this table; write each joint once.")
    names = content
    if isinstance(content, dict) and "format" in content:
        if content["format"] != FORMAT or content.get("version") != VERSION:
            raise InputError(
                f"{path}: this is '{content['format']}' of version {content.get('version')}; expected '{FORMAT}' of version {VERSION}."
            )
        names = content.get("names")
    if not isinstance(names, dict) or not names:
        raise InputError(
            f"{path}: the file has no table of joints; write an object that maps joint names of the source to those of the target."
        )
    for here, there in names.items():
        if not isinstance(there, str | None):
            raise InputError(
                f"{path}: '{here}' is mapped to {json.dumps(there)[:40]}; expected the name of a joint of the target, or null."
            )
    return {here: there for here, there in names.items() if there != ""}
