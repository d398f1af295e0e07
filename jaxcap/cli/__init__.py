"""The command line: one file per verb. `main` is the program `jaxcap`."""

import sys
from collections.abc import Sequence

from .console.errors import report_errors
from .console.groups import JAXCAP
from .console.heartbeat import periodic_status
from .console.verbs import run_verb

#: option of every verb: compile without the cache
NO_CACHE = "--no-cache"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one verb. An input error prints one line on stderr and raises `SystemExit(2)`."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    with report_errors(), periodic_status():
        if arguments == ["--version"]:
            sys.stdout.write(f"jaxcap {_version()}\n")
            return
        words = [word for word in arguments if word != NO_CACHE]
        run_verb(JAXCAP, "jaxcap", words, use_cache=NO_CACHE not in arguments)


def _version() -> str:
    import importlib.metadata

    try:
        return importlib.metadata.version("jaxcap")
    except importlib.metadata.PackageNotFoundError:
        return "(source tree, not installed)"
