"""Types of options that several verbs share, with the names that help shows for their values."""

from pathlib import Path
from typing import Annotated

import tyro

from .sources import Up as Up

arg = tyro.conf.arg
#: bodies and clouds as written by a user; see `sources`
BodySpec = tyro.conf.Positional[Annotated[str, arg(metavar="BODY")]]
CloudsSpec = tyro.conf.Positional[Annotated[str, arg(metavar="CLOUDS")]]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
OptionalCount = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
OptionalUnit = Annotated[str | None, arg(metavar="UNIT", help_behavior_hint="")]
Unit = Annotated[str, arg(metavar="UNIT")]
Flag = Annotated[bool, arg(help_behavior_hint="")]
