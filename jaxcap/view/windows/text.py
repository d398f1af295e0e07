"""Text for viser's markdown, which renders HTML unescaped: names in a foreign file must not become markup."""

import re

_PUNCTUATION = re.compile(r"([!-/:-@\[-`{-~])")


def as_markdown(text: str) -> str:
    """Escape a text so that markdown shows it literally, in one paragraph."""
    return _PUNCTUATION.sub(r"\\\1", " ".join(text.split()))
