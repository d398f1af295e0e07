"""The one place where what went wrong becomes one line and an exit code."""

import contextlib
import sys
import warnings
from collections.abc import Iterator

from ...errors import is_sentence, sentence_of

#: what a user can mend, and Ctrl-C as shells count it
WRONG, STOPPED = 2, 130


@contextlib.contextmanager
def told() -> Iterator[None]:
    """Errors a user can mend end in one line on stderr and exit code 2, Ctrl-C in 130; warnings are lines, too."""
    show = warnings.showwarning
    warnings.showwarning = _tell_warning
    try:
        yield
    except BrokenPipeError:
        # the reader of our output has enough; Python would complain once more at the end
        sys.stdout = None
        raise SystemExit(0) from None
    except (ValueError, OSError) as error:
        if not isinstance(error, OSError) and not is_sentence(error):
            raise
        sys.stderr.write(f"jaxcap: {' '.join(sentence_of(error).split())}\n")
        raise SystemExit(WRONG) from None
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\njaxcap: {' '.join(str(stop).split()) or 'stopped'}\n")
        raise SystemExit(STOPPED) from None
    finally:
        warnings.showwarning = show


def _tell_warning(message: Warning | str, *_) -> None:
    sys.stderr.write(f"jaxcap: {' '.join(str(message).split())}\n")
