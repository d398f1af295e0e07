"""The choice of a verb from the command line's arguments."""

import contextlib
import difflib
import importlib
import io
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ...errors import InputError
from .heartbeat import set_activity
from .help import verb_help, wide_terminal
from .parse_errors import parse_error_sentence
from .stopping import exit_on_interrupt


class Verb(NamedTuple):
    """A verb that is not imported yet."""

    #: its class relative to `jaxcap.cli`: `edit.cut.Cut`
    class_path: str
    #: one line of the help
    summary: str

    def load(self) -> Any:
        """Import the class."""
        module, _, name = self.class_path.rpartition(".")
        return getattr(importlib.import_module(f"jaxcap.cli.{module}"), name)


class VerbGroup(NamedTuple):
    """Verbs and groups of verbs by name."""

    summary: str
    description: str
    verbs: "Mapping[str, Verb | VerbGroup]"


def run_verb(group: VerbGroup, prog: str, arguments: Sequence[str], use_cache: bool = True) -> None:
    """Run the verb named by the first arguments with the others; without arguments, print the help. Only this
    verb is imported; `use_cache` enables the cache of compiled functions.

    **Raises:** `InputError` if the verb or an option does not exist, or an option is missing or has an
    invalid value.
    """
    verb, prog, words = find_verb(group, prog, arguments)
    command = parse_command(verb, prog, words, use_cache)
    set_activity(prog.rpartition(" ")[2])
    command.run()


def find_verb(group: VerbGroup, prog: str, arguments: Sequence[str]) -> tuple[Verb, str, list[str]]:
    """Find the verb that the first arguments name; return it with its program name and the other arguments.

    The help of a group is printed, if it is asked for or no verb is named. Raises `InputError` if the verb does not exist.
    """
    word, *rest = arguments or ["--help"]
    if word in ("-h", "--help"):
        sys.stdout.write(help_of(group, prog))
        raise SystemExit(0)
    found = group.verbs.get(word)
    if found is None:
        what = f"no option '{word}' of '{prog}'" if word.startswith("-") else f"no '{prog} {word}'"
        raise InputError(f"there is {what}{_meant(word, group.verbs)}; verbs are {', '.join(group.verbs)}.")
    if isinstance(found, VerbGroup):
        return find_verb(found, f"{prog} {word}", rest)
    return found, f"{prog} {word}", rest


def help_of(group: VerbGroup, prog: str) -> str:
    """Format the help of a group of verbs."""
    wide = max(map(len, group.verbs))
    lines = [f"  {name:{wide}}  {verb.summary}" for name, verb in group.verbs.items()]
    return "\n".join(
        [
            f"usage: {prog} VERB ...",
            "",
            group.description,
            "",
            *lines,
            "",
            f"'{prog} VERB --help' lists the options of a verb; 'jaxcap --version' prints the version.",
            "",
        ]
    )


def parse_command(verb: Verb, prog: str, words: Sequence[str], use_cache: bool = True) -> Any:
    """Parse arguments to an instance of a verb; print its help if it is asked for. Raises `InputError` if they are wrong.

    A class that runs another verb separates the words of that verb, by `split_words`, and takes them by `with_command`.
    """
    with exit_on_interrupt():
        from .compiled import prepare_jax

        prepare_jax(use_cache)
        import tyro

        made = verb.load()
    runs_another = hasattr(made, "split_words")
    own, command = made.split_words(words) if runs_another else (words, ())
    if {"-h", "--help"} & set(own):
        sys.stdout.write(verb_help(made, prog))
        raise SystemExit(0)
    said = io.StringIO()
    try:
        with wide_terminal(), contextlib.redirect_stderr(said):
            found = tyro.cli(made, prog=prog, args=own, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as stop:
        if not stop.code:
            raise
        raise InputError(parse_error_sentence(made, prog, said.getvalue())) from None
    return found.with_command(command) if runs_another else found


def _meant(word: str, verbs: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, verbs, 1)
    return f" (did you mean '{close[0]}'?)" if close else ""
