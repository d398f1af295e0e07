"""Types of options that several verbs share, with the names that help shows for their values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from .sources import Up as Up

arg = tyro.conf.arg
#: bodies and clouds as written by a user; see `sources`
BodySpec = tyro.conf.Positional[Annotated[str, arg(metavar="BODY")]]
CloudsSpec = tyro.conf.Positional[Annotated[tuple[str, ...], arg(metavar="CLOUDS...", help_behavior_hint="")]]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
OptionalCount = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
OptionalUnit = Annotated[str | None, arg(metavar="UNIT", help_behavior_hint="")]
Unit = Annotated[str, arg(metavar="UNIT")]
Flag = Annotated[bool, arg(help_behavior_hint="")]


def clouds_words(clouds: Sequence[str]) -> str:
    """What clouds were asked for, in a few words: a shell makes many of one glob."""
    if len(clouds) <= 1:
        return "".join(clouds)
    return f"{clouds[0]} ... {clouds[-1]} ({len(clouds)} files)"
