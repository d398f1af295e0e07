"""Errors that a user can correct."""

import dis
from collections.abc import Sequence
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


class InputError(ValueError):
    """An error in the user's input; the message is one sentence with the fault, its location and the
    remedy.

    The command line prints it alone and exits with 2. The name of the public `function` that received the
    input is put before the sentence.
    """

    def __init__(self, message: str, function: str = ""):
        super().__init__(f"{function}: {message}" if function else message)
        self.message, self.function = message, function


class NoPersonError(InputError):
    """A frame that shows no person; other frames of its sequence may be valid."""


class TracedArgumentError(InputError):
    """A traced argument of a function that runs in NumPy."""

    def __init__(self, argument: str, function: str):
        super().__init__(
            f"`{argument}` is traced by jit, grad or vmap, and parts of this function run in NumPy. Call it outside of them; "
            "`solve`, `solve_sequence`, `solve_calibration` and `solve_joints` have derivatives.",
            function,
        )


def user_message(error: BaseException) -> str:
    """Return the message of an error without the name of a library function.

    It is for files and the command line, whose users have not called that function.
    """
    return error.message if isinstance(error, InputError) else str(error)


def is_user_error(error: BaseException) -> bool:
    """Test if the message of an error was written for users.

    That of an `InputError` is, and that of a `ValueError` from a `raise` statement of this package. A
    `ValueError` of another library is not. C functions leave no frame in the traceback, so the instruction
    that failed is tested, not only its file.
    """
    if isinstance(error, InputError):
        return True
    if not isinstance(error, ValueError) or error.__traceback__ is None:
        return False
    last = error.__traceback__
    while last.tb_next is not None:
        last = last.tb_next
    code = last.tb_frame.f_code
    raised = dis.opname[code.co_code[last.tb_lasti]] == "RAISE_VARARGS"
    return raised and _PACKAGE in Path(code.co_filename).resolve().parents


def join_names(names: Sequence[str]) -> str:
    """Join names as in a sentence: `a`, `a and b`, `a, b and c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
