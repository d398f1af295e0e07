"""One of several verbs from the command line's words."""

import contextlib
import difflib
import io
import re
from collections.abc import Mapping, Sequence

from ..errors import InputError

#: what tyro draws its boxes with, where a terminal has more than ASCII and where it has not
_RULE = re.compile("─+|-{3,}")
#: columns by which what is missing is set in, and what explains it
_SET_IN, _EXPLAINED = 4, 8


def run_verb(verbs: Mapping[str, type], prog: str, description: str, arguments: Sequence[str]) -> None:
    """Make the verb that the arguments name of the rest of them, and run it; without any, tell the help.

    **Raises:** `InputError` where there is no such verb or option, one is missing, or has a value that it cannot have.
    """
    import tyro

    words = list(arguments) or ["--help"]
    if not words[0].startswith("-") and words[0] not in verbs:
        raise InputError(
            f"there is no '{prog} {words[0]}'{_meant(words[0], verbs)}; verbs are {', '.join(verbs)}."
        )
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            command = tyro.extras.subcommand_cli_from_dict(
                dict(verbs),
                prog=prog,
                description=description,
                args=words,
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        raise InputError(unboxed(said.getvalue())) from None
    command.run()


def unboxed(box: str) -> str:
    """What a box of tyro's says, in one sentence. Its parts are below each other with lines between them; what is missing
    is set in, and explained further in, which the help does as well."""
    # a title is in the box's upper edge, or stands above the first line
    rows = [row.strip("│") for row in box.splitlines() if row.strip() and row[0] not in "╭╰"]
    rows = rows[0 if "╭" in box else 1 :]
    left = min((len(row) - len(row.lstrip()) for row in rows if not _RULE.fullmatch(row.strip())), default=0)
    parts: list[str] = [""]
    for row in rows:
        depth, text = len(row) - len(row.lstrip()) - left, row.strip()
        if _RULE.fullmatch(text):
            parts.append("")
        elif depth < _EXPLAINED:
            apart = ", " if depth == _SET_IN and not parts[-1].endswith(":") else " "
            parts[-1] += f"{apart}{text}" if parts[-1] else text
    # how each type of several failed, of which one is that nothing is given
    texts = [re.sub(r" Got errors:.*", "", part).replace("{None}|", "").rstrip(".") for part in parts]
    texts = [re.sub(r"'None', |, 'None'", "", text) for text in texts]
    return "; ".join(text[0].lower() + text[1:] for text in texts if text) + "."


def _meant(word: str, verbs: Mapping[str, type]) -> str:
    close = difflib.get_close_matches(word, verbs, 1)
    return f" (did you mean '{close[0]}'?)" if close else ""
