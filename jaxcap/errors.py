"""Errors that a user can mend."""

import dis
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


class InputError(ValueError):
    """Something the user gave is wrong; the message is one sentence that says what was
    found, where, and what to do. The command line prints it alone and exits with 2.

    A public `function` that was given it is named before the sentence.
    """

    def __init__(self, sentence: str, function: str = ""):
        super().__init__(f"{function}: {sentence}" if function else sentence)
        self.sentence, self.function = sentence, function


def sentence_of(error: BaseException) -> str:
    """Return what an error says, without the function of the library that it is told of: for files and the command line,
    whose users have not called it."""
    return error.sentence if isinstance(error, InputError) else str(error)


def is_sentence(error: BaseException) -> bool:
    """Whether the message of an error was written for users.

    That of an `InputError` is. So is that of a `ValueError` which a `raise` statement of this package raised. The
    `ValueError` of another library is not: its C functions leave no frame in the traceback, so the instruction that
    failed decides, and not its file alone.
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
