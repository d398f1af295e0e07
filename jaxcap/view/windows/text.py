"""Text for viser's markdown, which renders HTML as it comes: names in a file of somebody else are no markup."""

import re

_PUNCTUATION = re.compile(r"([!-/:-@\[-`{-~])")


def as_markdown(text: str) -> str:
    """Escape a text so that markdown shows it as it is, in one paragraph."""
    return _PUNCTUATION.sub(r"\\\1", " ".join(text.split()))
