"""The files beside a mesh that make it a body: its skeleton (`.skl`) and the joint of each vertex (`.vj`)."""

from pathlib import Path
from typing import NamedTuple


class Bones(NamedTuple):
    """Files of the mesh's own name."""

    skeleton: Path
    parts: Path


def bones_beside(mesh: str | Path) -> Bones | None:
    """Return the files that make a mesh a body; None where one of them is not there."""
    mesh = Path(mesh)
    found = Bones(mesh.with_suffix(".skl"), mesh.with_suffix(".vj"))
    return found if mesh.is_file() and all(path.is_file() for path in found) else None
