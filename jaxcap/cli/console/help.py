"""The help of one verb: its options in the same groups for all verbs, the basic ones first."""

import contextlib
import io
import os
import re
import shutil
import textwrap
from collections.abc import Iterator

#: groups in order, with their options; any other option is a setting of the verb itself
BASICS, INPUT, OUTPUT, KINEBEN = "Basics", "Input", "Output", "Separate skeleton files"
GROUPS: dict[str, tuple[str, ...]] = {
    BASICS: ("out", "resume", "overwrite", "help"),
    INPUT: (
        "unit",
        "up",
        "rate",
        "first",
        "last",
        "vertices",
        "body",
        "motion",
        "source",
        "start",
        "fitted",
        "frame",
        "pose",
        "skeleton",
        "template",
        "clouds",
        "depth",
        "depth-scale",
        "masks",
        "cameras",
        "limits",
        "prior",
        "constraints",
        "truth",
        "meshes",
        "markers",
        "trunk",
        "subject",
        "pieces",
        "segments",
        "names",
        "points",
    ),
    OUTPUT: (
        "as",
        "npz",
        "keys",
        "write-names",
        "filled",
        "report",
        "report-every",
        "picture",
        "rows",
        "target-unit",
    ),
    KINEBEN: ("skl", "vj"),
}
#: titles of a verb's own settings, and options that are in another group for some verbs
TITLES = {
    "track": "Tracking",
    "live": "Live tracking",
    "adapt": "Adaptation",
    "learn": "Learning",
    "scan": "Cameras and measurement errors",
    "markers fit": "Calibration",
    "markers solve": "Solving",
    "limits learn": "Learning",
    "prior learn": "Learning",
    "batch": "Cluster",
    "ik": "Inverse kinematics",
    "view": "Window",
}
MOVED = {
    "learn": {"motion": OUTPUT, "pairs": "Learning"},
    "adapt": {"motion": OUTPUT},
    "markers fit": {"joints": OUTPUT},
    "markers solve": {"joints": OUTPUT},
    "scan": {"points": "", "vertices": "", "rate": INPUT},
    "evaluate": {"points": INPUT},
    "edit cut": {"frames": BASICS},
    "edit retarget": {"target-unit": INPUT},
}
#: column of the option descriptions, and maximum line width
COLUMN, WIDEST = 26, 110
_NAMES = re.compile(r"--(?:no-(?!browser))?([a-z0-9][a-z0-9-]*)")


def verb_help(verb: type, prog: str) -> str:
    """Return the help of a verb, whose fields are its options, arranged in groups."""
    import tyro

    said = io.StringIO()
    with wide_terminal(), contextlib.suppress(SystemExit), contextlib.redirect_stdout(said):
        tyro.cli(verb, prog=prog, args=["--help"], config=(tyro.conf.FlagCreatePairsOff,))
    return group_options(said.getvalue(), prog.removeprefix("jaxcap "))


@contextlib.contextmanager
def wide_terminal() -> Iterator[None]:
    """Make tyro write unbroken lines, as it breaks lines within words."""
    columns = os.environ.get("COLUMNS")
    try:
        os.environ["COLUMNS"] = "10000"
        yield
    finally:
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns


def group_options(text: str, verb: str) -> str:
    """Arrange the options of a tyro help text without boxes in the groups of a verb.

    In that text an entry is indented by two columns, its further lines by more, and titles by one.
    """
    width = min(shutil.get_terminal_size().columns, WIDEST)
    rows = [line.rstrip() for line in text.splitlines()]
    start = next((number for number, row in enumerate(rows) if row.startswith(" ")), len(rows))
    entries: list[str] = []
    for row in rows[start:]:
        if row.startswith("   ") and entries:
            entries[-1] += ("  " if "  " not in entries[-1] else " ") + row.strip()
        elif row.startswith("  "):
            entries.append(row.strip())
    found: dict[str, list[str]] = {BASICS: [], INPUT: [], _title(verb): [], OUTPUT: [], KINEBEN: []}
    for entry in entries:
        found[_group(entry, verb)].append(entry)
    found[BASICS].sort(key=_basic_option_order)
    paragraphs = [textwrap.fill(part, width) for part in "\n".join(rows[:start]).split("\n\n")]
    blocks = [
        "\n".join([f"{title}:", *(_format_entry(entry, width) for entry in group)])
        for title, group in found.items()
        if group
    ]
    return "\n\n".join([*filter(None, paragraphs), *blocks]) + "\n"


def _format_entry(entry: str, width: int) -> str:
    """Format an entry: names to the left, their description to the right or below."""
    names, _, meaning = entry.partition("  ")
    blank = " " * COLUMN
    text = textwrap.fill(
        " ".join(meaning.replace("(default: )", "").split()),
        width,
        initial_indent=blank,
        subsequent_indent=blank,
        break_on_hyphens=False,
    )
    names = f"  {names}"
    return f"{names}\n{text}" if len(names) > COLUMN - 2 else names + text[len(names) :]


def _title(verb: str) -> str:
    return TITLES.get(verb, "Settings")


def _group(entry: str, verb: str) -> str:
    """Find the group of an entry by the last of its names."""
    name = _name(entry)
    moved = MOVED.get(verb, {}).get(name)
    if name == "" or moved is not None:
        return BASICS if moved is None else moved or _title(verb)
    return next((title for title, options in GROUPS.items() if name in options), _title(verb))


def _basic_option_order(entry: str) -> int:
    """Return the sort key of a basic option; positional ones come first."""
    name = _name(entry)
    return GROUPS[BASICS].index(name) if name in GROUPS[BASICS] else -1


def _name(entry: str) -> str:
    """Extract the name of an option without dashes; empty for a positional one."""
    return _NAMES.findall(entry.split("  ")[0])[-1] if entry.startswith("-") else ""
