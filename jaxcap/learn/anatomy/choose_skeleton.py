"""The choice between the human skeleton and a free search for joints."""

from collections.abc import Sequence
from typing import Literal

from ...errors import InputError
from ...observe.meshes import MeshSequence
from .find_person import PlacedPerson, find_person

#: `human` in meshes of people and free search else; the human skeleton; the free search
SkeletonName = Literal["automatic", "human", "none"]


def choose_skeleton(
    meshes: MeshSequence, name: SkeletonName, names: Sequence[str] | None = None
) -> tuple[PlacedPerson | None, str]:
    """Place the human skeleton in one of the meshes, or choose a free search; return also a sentence about the choice.

    **Arguments:** `names` of the meshes for the sentence.

    **Raises:** `InputError` if `name` is "human" and no person is recognised, or if `name` is unknown.
    """
    if name == "none":
        return None, "joints are searched for freely, from the motion alone"
    if name not in ("automatic", "human"):
        raise InputError(
            f"The skeleton '{name}' is unknown; give 'automatic', 'human' or 'none', or a skeleton."
        )
    found = find_person(meshes)
    if isinstance(found, PlacedPerson):
        called = f"mesh {found.frame}" if names is None else names[found.frame]
        return found, f"a person was recognised in {called}; learning begins with the human skeleton there"
    if name == "human":
        raise InputError(
            f"The human skeleton cannot be placed: {found.reason}; give a mesh of the person upright, with the arms away from "
            "the body, or a skeleton that is aligned with the first mesh, or search for joints freely (`--skeleton none`)."
        )
    return None, f"joints are searched for freely, as {found.reason}"
