"""The files among the options of a verb: those that it reads, and those that it writes."""

import dataclasses
import functools
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

#: options with the paths of outputs, for all verbs and for some
OUTPUTS = (
    "out",
    "report",
    "picture",
    "joints",
    "filled",
    "write_names",
    "keys",
    "parameters",
    "tracks",
    "target",
)
OUTPUTS_BY_VERB = {"learn": ("motion",), "adapt": ("motion",)}


@functools.cache
def output_fields(verb: str, command: type) -> tuple[str, ...]:
    """List the fields with the paths of outputs of a verb, such as `markers solve`, and its class."""
    names = (*OUTPUTS, *OUTPUTS_BY_VERB.get(verb, ()))
    types = typing.get_type_hints(command)
    return tuple(name for name in types if name in names and "Path" in str(types[name]))


def output_paths(verb: str, command: Any) -> Iterator[Path]:
    """Iterate over the paths of the outputs that a command names."""
    for name in output_fields(verb, type(command)):
        for path in _leaves(getattr(command, name)):
            if not _is_within_out(command, name, path):
                yield Path(path)


def input_values(verb: str, command: Any) -> Iterator[str]:
    """Iterate over the values of a command that may name inputs: all texts and paths that are no outputs."""
    outputs = output_fields(verb, type(command))
    for each in dataclasses.fields(command):
        if each.name not in outputs:
            yield from map(str, _leaves(getattr(command, each.name)))


def replace_outputs(verb: str, command: Any, place: Callable[[Path], Path]) -> Any:
    """Return a command that writes to other paths."""
    changed = {
        name: _map_leaves(
            getattr(command, name),
            lambda path, name=name: path if _is_within_out(command, name, path) else place(Path(path)),
        )
        for name in output_fields(verb, type(command))
    }
    return dataclasses.replace(command, **changed)


def replace_inputs(verb: str, command: Any, place: Callable[[str], str]) -> Any:
    """Return a command that reads other files."""
    outputs = output_fields(verb, type(command))
    return replace_texts(command, lambda text: place(text), skip=outputs)


def replace_texts(command: Any, change: Callable[[str], str], skip: typing.Sequence[str] = ()) -> Any:
    """Return a command with changed texts and paths, except in the fields to `skip`."""

    def changed(leaf: str | Path) -> str | Path:
        return type(leaf)(change(str(leaf)))

    values = {
        each.name: _map_leaves(getattr(command, each.name), changed)
        for each in dataclasses.fields(command)
        if each.name not in skip
    }
    return dataclasses.replace(command, **values)


def _is_within_out(command: Any, name: str, path: str | Path) -> bool:
    """Test if an output is a name without a folder that the verb puts into its output folder, as --joints does."""
    out = getattr(command, "out", None)
    several = isinstance(getattr(command, name), tuple)
    return several and out is not None and not out.suffix and Path(path).parent == Path(".")


def _leaves(value: Any) -> Iterator[str | Path]:
    if isinstance(value, (str, Path)):
        yield value
    elif isinstance(value, tuple):
        for each in value:
            yield from _leaves(each)


def _map_leaves(value: Any, function: Callable) -> Any:
    if isinstance(value, (str, Path)):
        return function(value)
    if isinstance(value, tuple):
        return tuple(_map_leaves(each, function) for each in value)
    return value
