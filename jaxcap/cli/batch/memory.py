"""The memory that is assumed for a job of each verb; it limits the number of workers."""

from collections.abc import Iterable

from ...batch.size import GIB

#: GiB of one process, for recordings of usual sizes: estimates with a margin, of which `docs/scale.md` lists what was measured
BY_VERB = {"adapt": 4.0, "learn": 4.0, "register": 4.0, "track": 3.0, "rig": 2.5, "demo": 3.0}
DEFAULT = 2.0


def job_memory(verbs: Iterable[str]) -> float:
    """Return the memory that the most demanding of some verbs may need, bytes."""
    return GIB * max((BY_VERB.get(verb, DEFAULT) for verb in verbs), default=DEFAULT)
