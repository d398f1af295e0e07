"""The conversion of errors to one line on stderr and an exit code."""

import contextlib
import sys
import warnings
from collections.abc import Iterator

from ...errors import is_user_error, user_message
from .console import warn

#: exit codes of an input error, and of Ctrl-C as in shells
EXIT_INPUT_ERROR, EXIT_INTERRUPTED = 2, 130


@contextlib.contextmanager
def report_errors() -> Iterator[None]:
    """Convert input errors to one line on stderr and exit code 2, and Ctrl-C to 130; warnings become lines,
    too."""
    try:
        with warnings_as_lines():
            yield
    except BrokenPipeError:
        # the reader closed the pipe; without this Python would report it again at exit
        sys.stdout = None
        raise SystemExit(0) from None
    except (ValueError, OSError) as error:
        sentence = error_sentence(error)
        if sentence is None:
            raise
        sys.stderr.write(f"jaxcap: {sentence}\n")
        raise SystemExit(EXIT_INPUT_ERROR) from None
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\njaxcap: {' '.join(str(stop).split()) or 'stopped'}\n")
        raise SystemExit(EXIT_INTERRUPTED) from None


def error_sentence(error: BaseException) -> str | None:
    """Return the sentence of an error that a user can correct, as one line; None for other errors."""
    if isinstance(error, OSError) or is_user_error(error):
        return " ".join(user_message(error).split())
    return None


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Show warnings as message lines, each as often as in a new process: Python otherwise shows those of a line of code once."""
    # a change of the filters, as this is, makes Python forget the warnings that it has shown
    with warnings.catch_warnings():
        warnings.showwarning = _print_warning
        yield


def _print_warning(message: Warning | str, *_) -> None:
    warn(" ".join(str(message).split()))
