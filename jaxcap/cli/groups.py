"""Verbs that come in groups: `jaxcap markers fit`, `jaxcap limits learn`."""

from collections.abc import Sequence
from dataclasses import dataclass

from .verbs import run_verb

MARKERS = """Optical markers: what is in a file of them, a subject from takes, its motion through trials.

`jaxcap markers VERB --help` explains a verb. Results are in metres."""
LIMITS = """Joint limits: learned from motions, what of a motion is beyond them, a motion turned back into them.

`jaxcap limits VERB --help` explains a verb. Angles are in degrees."""

PRIOR = """Pose priors: how likely joints turn together, learned from motions.

`jaxcap prior VERB --help` explains a verb. Angles are in degrees."""

EDIT = """Motions edited: given to another body, cut, joined, looped, mirrored, thinned to keys, made to look somewhere; and a
scan that moves with its body.

`jaxcap edit VERB --help` explains a verb. Results are in metres, y up."""


@dataclass
class Markers:
    """Optical markers; `jaxcap markers --help` tells its verbs."""

    def run(self) -> None:
        run_markers(["--help"])


@dataclass
class Limits:
    """Joint limits; `jaxcap limits --help` tells its verbs."""

    def run(self) -> None:
        run_limits(["--help"])


@dataclass
class Prior:
    """Pose priors; `jaxcap prior --help` tells its verbs."""

    def run(self) -> None:
        run_prior(["--help"])


@dataclass
class Edit:
    """Motion editing; `jaxcap edit --help` tells its verbs."""

    def run(self) -> None:
        run_edit(["--help"])


def run_markers(arguments: Sequence[str]) -> None:
    """Run one verb of `jaxcap markers`."""
    from .markers.fit import Fit
    from .markers.info import Info
    from .markers.solve import Solve

    run_verb({"info": Info, "fit": Fit, "solve": Solve}, "jaxcap markers", MARKERS, arguments)


def run_limits(arguments: Sequence[str]) -> None:
    """Run one verb of `jaxcap limits`."""
    from .limits.check import Check
    from .limits.compare import Compare
    from .limits.learn import Learn
    from .limits.project import Project

    verbs = {"learn": Learn, "check": Check, "project": Project, "compare": Compare}
    run_verb(verbs, "jaxcap limits", LIMITS, arguments)


def run_prior(arguments: Sequence[str]) -> None:
    """Run one verb of `jaxcap prior`."""
    from .prior.info import Info
    from .prior.learn import Learn

    run_verb({"learn": Learn, "info": Info}, "jaxcap prior", PRIOR, arguments)


def run_edit(arguments: Sequence[str]) -> None:
    """Run one verb of `jaxcap edit`."""
    from .edit.cut import Cut
    from .edit.gaze import Gaze
    from .edit.glue import Glue
    from .edit.join import Join
    from .edit.keys import Keys
    from .edit.loop import Loop
    from .edit.mirror import Mirror
    from .edit.resample import Resample
    from .edit.retarget import Retarget

    verbs = {
        "retarget": Retarget,
        "gaze": Gaze,
        "glue": Glue,
        "cut": Cut,
        "join": Join,
        "loop": Loop,
        "resample": Resample,
        "mirror": Mirror,
        "keys": Keys,
    }
    run_verb(verbs, "jaxcap edit", EDIT, arguments)


#: what takes the words behind a group's name
GROUPS = {"markers": run_markers, "limits": run_limits, "prior": run_prior, "edit": run_edit}
