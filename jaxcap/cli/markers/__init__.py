"""`jaxcap markers`: what is done with optical markers, one file a verb."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..verbs import run_verb

DESCRIPTION = """Optical markers: what is in a file of them, a subject from takes, its motion through trials.

`jaxcap markers VERB --help` explains a verb. Results are in metres."""


@dataclass
class Markers:
    """Optical markers; `jaxcap markers --help` tells its verbs."""

    def run(self) -> None:
        run_markers(["--help"])


def run_markers(arguments: Sequence[str]) -> None:
    """Run one verb of `jaxcap markers`."""
    from .fit import Fit
    from .info import Info
    from .solve import Solve

    run_verb({"info": Info, "fit": Fit, "solve": Solve}, "jaxcap markers", DESCRIPTION, arguments)
