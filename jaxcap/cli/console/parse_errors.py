"""Sentences for command line arguments that a verb does not accept, from the error boxes of tyro."""

import ast
import re
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

#: horizontal lines of tyro's boxes, on terminals with Unicode and with ASCII only
_RULE = re.compile("─+|-{3,}")
#: columns of indentation of a missing option, and of its description
_OPTION_INDENT, _DESCRIPTION_INDENT = 4, 8
#: errors of a value: the option, and the value as text or as a Python literal
_INVALID_CHOICE = re.compile(
    r"invalid choice '(?P<text>.*)' for argument '(?P<option>[^']*)'\. Expected one of"
)
_UNREADABLE_VALUE = re.compile(
    r"Error parsing (?P<option>[^:]+): (?:no type matching .+? could be instantiated from"
    r"|could not convert string to float:|invalid literal for int\(\) with base 10:"
    r"|Could not parse arguments) (?P<literal>\[.*?\](?= into tuple|\.)|'.*'|\".*\")"
)
_MISSING_VALUE = re.compile(r"Missing value for argument '(?P<option>[^']*)'\. Expected")
#: singular and plural of the values of a type
_TYPE_NAMES = {int: ("an integer", "integers"), float: ("a number", "numbers")}


def parse_error_sentence(verb: type, prog: str, box: str) -> str:
    """Convert an error box of tyro, of unbroken lines, to one sentence about the options of a verb.

    For a value of the wrong type or a wrong choice, the sentence names the option, the value, and the expected
    values.
    """
    rows = " ".join(row.strip("│| ") for row in box.splitlines())
    if found := _INVALID_CHOICE.search(rows):
        option, problem = found["option"], f"is '{found['text']}'"
    elif found := _UNREADABLE_VALUE.search(rows):
        option, problem = found["option"], f"is '{_value_text(found['literal'])}'"
    elif found := _MISSING_VALUE.search(rows):
        option, problem = found["option"], "lacks a value"
        if not option.startswith("-"):
            # of a positional argument, before a word that is taken for an option
            return (
                f"missing from {prog}: {option.upper()}, which is written without an option such as -o; '{prog} --help' lists the "
                "options."
            )
    else:
        return error_box_sentence(box, prog)
    # of several names, such as `-o/--out`, the last one is the longest
    name = option.rpartition("/")[2]
    return f"{name} {problem}; give {_expected(_annotations(verb).get(_bare(name)))}."


def error_box_sentence(box: str, prog: str) -> str:
    """Convert an error box of tyro to one sentence. Its parts are separated by horizontal lines; missing
    options are indented, and their descriptions, which the help repeats, further."""
    # the title is in the box's upper edge, or above the first line
    rows = [row.strip("│") for row in box.splitlines() if row.strip() and row[0] not in "╭╰"]
    rows = rows[0 if "╭" in box else 1 :]
    left = min((len(row) - len(row.lstrip()) for row in rows if not _RULE.fullmatch(row.strip())), default=0)
    parts: list[str] = [""]
    for row in rows:
        depth, text = len(row) - len(row.lstrip()) - left, row.strip()
        if _RULE.fullmatch(text):
            parts.append("")
        elif depth < _DESCRIPTION_INDENT:
            separator = ", " if depth == _OPTION_INDENT and not parts[-1].endswith(":") else " "
            parts[-1] += f"{separator}{text}" if parts[-1] else text
    texts = [part.rstrip(".") for part in parts if part and not part.startswith("For full helptext")]
    return "; ".join([text[0].lower() + text[1:] for text in texts] + [f"'{prog} --help' lists the options."])


def _annotations(verb: type) -> dict[str, Any]:
    """Return the annotations of a verb's fields by the names of the options."""
    found = {}
    for field, annotation in get_type_hints(verb, include_extras=True).items():
        given = (getattr(part, "name", None) for part in _metadata(annotation))
        found[_bare(next(filter(None, given), field))] = annotation
    return found


def _metadata(annotation: Any) -> tuple[Any, ...]:
    return annotation.__metadata__ if get_origin(annotation) is Annotated else ()


def _bare(name: str) -> str:
    """Return the name of an option or a field without dashes, for comparison."""
    return name.strip("-_").replace("_", "-").lower()


def _expected(annotation: Any) -> str:
    """Describe the values of an annotation, as in "an integer", or "x, y or z"."""
    if get_origin(annotation) is Annotated:
        return _expected(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return _expected(next(part for part in get_args(annotation) if part is not NoneType))
    inner = get_args(annotation)
    if get_origin(annotation) is Literal:
        return f"{', '.join(map(str, inner[:-1]))} or {inner[-1]}"
    if get_origin(annotation) is tuple and inner[0] in _TYPE_NAMES:
        plural = _TYPE_NAMES[inner[0]][1]
        return plural if inner[-1] is Ellipsis else f"{len(inner)} {plural}"
    return _TYPE_NAMES.get(annotation, ("one", ""))[0]


def _value_text(literal: str) -> str:
    """Return the words of a Python literal of a text or of a list of texts."""
    value = ast.literal_eval(literal)
    return value if isinstance(value, str) else " ".join(value)
