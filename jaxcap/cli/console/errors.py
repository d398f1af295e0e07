"""The conversion of errors to one line on stderr and an exit code."""

import contextlib
import sys
import warnings
from collections.abc import Iterator

from ...errors import is_user_error, user_message

#: exit codes of an input error, and of Ctrl-C as in shells
EXIT_INPUT_ERROR, EXIT_INTERRUPTED = 2, 130


@contextlib.contextmanager
def report_errors() -> Iterator[None]:
    """Convert input errors to one line on stderr and exit code 2, and Ctrl-C to 130; warnings become lines,
    too."""
    show = warnings.showwarning
    warnings.showwarning = _print_warning
    try:
        yield
    except BrokenPipeError:
        # the reader closed the pipe; without this Python would report it again at exit
        sys.stdout = None
        raise SystemExit(0) from None
    except (ValueError, OSError) as error:
        if not isinstance(error, OSError) and not is_user_error(error):
            raise
        sys.stderr.write(f"jaxcap: {' '.join(user_message(error).split())}\n")
        raise SystemExit(EXIT_INPUT_ERROR) from None
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\njaxcap: {' '.join(str(stop).split()) or 'stopped'}\n")
        raise SystemExit(EXIT_INTERRUPTED) from None
    finally:
        warnings.showwarning = show


def _print_warning(message: Warning | str, *_) -> None:
    sys.stderr.write(f"jaxcap: {' '.join(str(message).split())}\n")
