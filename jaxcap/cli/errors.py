"""The one place where what went wrong becomes one line and an exit code."""

import contextlib
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

#: what a user can mend, and Ctrl-C as shells count it
WRONG, STOPPED = 2, 130
PACKAGE = Path(__file__).resolve().parents[1]


@contextlib.contextmanager
def told() -> Iterator[None]:
    """Errors a user can mend end in one line on stderr and exit code 2, Ctrl-C in 130."""
    try:
        yield
    except BrokenPipeError:
        # the reader of our output has enough; Python would complain once more at the end
        sys.stdout = None
        raise SystemExit(0) from None
    except (ValueError, OSError) as error:
        if not _is_sentence(error):
            raise
        sys.stderr.write(f"jaxcap: {' '.join(str(error).split())}\n")
        raise SystemExit(WRONG) from None
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\njaxcap: {' '.join(str(stop).split()) or 'stopped'}\n")
        raise SystemExit(STOPPED) from None


def _is_sentence(error: Exception) -> bool:
    """Whether an error is meant for users. A `ValueError` that jaxcap raised itself is; one that
    another library raised is a fault of ours, and shows where."""
    if isinstance(error, (InputError, OSError)):
        return True
    frames = traceback.extract_tb(error.__traceback__)
    return bool(frames) and PACKAGE in Path(frames[-1].filename).parents
