"""A decorator for readers that turns unexpected exceptions into errors about the file."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

from ...errors import InputError, is_user_error, user_message

P = ParamSpec("P")
T = TypeVar("T")


def reader_of(content: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a reader so that it returns data or raises `InputError`, and nothing else.

    The file is the first path among the reader's arguments; `content` is its type, with an article. Readers
    report the position in the file and the expected content themselves; this decorator is for errors that
    they do not foresee. The original exception is the cause of the `InputError`, so that a fault of the
    reader can be found.
    """

    def wrap(read: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(read)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return read(*args, **kwargs)
            except BrokenPipeError:
                # of the output, as in `jaxcap info body.npz | head`
                raise
            except Exception as error:
                given = (*args, *kwargs.values())
                path = next((value for value in given if isinstance(value, str | Path)), "the file")
                if not isinstance(error, InputError):
                    raise InputError(f"{path}: {_reason(error, content)}") from error
                if _names(error, path):
                    raise
                # constructors of bodies and motions report faults of their fields without the file's name
                raise InputError(f"{path}: {user_message(error)}") from None

        return guarded

    return wrap


def _names(error: InputError, path: str | Path) -> bool:
    """Check that an error names the file; always true if the path is a pattern or a folder."""
    try:
        return not Path(path).is_file() or Path(path).name in user_message(error)
    except (OSError, ValueError):
        return True


def _reason(error: Exception, content: str) -> str:
    if is_user_error(error):
        return user_message(error)
    if isinstance(error, FileNotFoundError):
        return "there is no such file; check the path."
    if isinstance(error, OSError):
        return f"cannot be read ({error.strerror or type(error).__name__}); give a readable file."
    if isinstance(error, MemoryError):
        return f"reading it as {content} needs more memory than is available; give a smaller file."
    if isinstance(error, RecursionError):
        return f"this is nested too deeply for {content}; export it again."
    return f"this cannot be read as {content}, as it is damaged or has unexpected content; export it again."
