"""The files that make a mesh a body: its skeleton (`.skl`) and the joint of each vertex (`.vj`)."""

from pathlib import Path
from typing import NamedTuple


class RigFiles(NamedTuple):
    """Files with the name of the mesh."""

    skeleton: Path
    parts: Path


def find_rig_files(mesh: str | Path) -> RigFiles | None:
    """Return the files that make a mesh a body; None if one of them does not exist."""
    mesh = Path(mesh)
    found = RigFiles(mesh.with_suffix(".skl"), mesh.with_suffix(".vj"))
    return found if mesh.is_file() and all(path.is_file() for path in found) else None
