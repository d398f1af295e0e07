"""The command line: one file a verb. `main` is the program `jaxcap`."""

import importlib.metadata
import sys
from collections.abc import Sequence

from .errors import told
from .verbs import run_verb

DESCRIPTION = """Fit articulated bodies to point clouds and meshes.

`jaxcap VERB --help` explains a verb, `jaxcap --version` tells the version. Results are in metres, y up."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one verb. A wrong input ends in one line on stderr and `SystemExit(2)`."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    with told():
        if arguments == ["--version"]:
            sys.stdout.write(f"jaxcap {_version()}\n")
            return
        from .adapt import Adapt
        from .convert import Convert
        from .demo import Demo
        from .evaluate import Evaluate
        from .fit import Fit
        from .groups import GROUPS, Edit, Limits, Markers, Prior
        from .ik import Ik
        from .info import Info
        from .learn import Learn
        from .rig import Rig
        from .scan import Scan
        from .track import Track
        from .view import View

        if arguments[:1] and arguments[0] in GROUPS:
            GROUPS[arguments[0]](arguments[1:])
            return
        verbs = {
            "demo": Demo,
            "rig": Rig,
            "learn": Learn,
            "fit": Fit,
            "adapt": Adapt,
            "track": Track,
            "evaluate": Evaluate,
            "scan": Scan,
            "markers": Markers,
            "limits": Limits,
            "prior": Prior,
            "edit": Edit,
            "view": View,
            "ik": Ik,
            "info": Info,
            "convert": Convert,
        }
        run_verb(verbs, "jaxcap", DESCRIPTION, arguments)


def _version() -> str:
    try:
        return importlib.metadata.version("jaxcap")
    except importlib.metadata.PackageNotFoundError:
        return "of a source tree, not installed"
