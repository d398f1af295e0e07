"""XML documents of OpenSim."""

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from ...errors import InputError
from ..text import read_text


def parse_document(path: Path, roots: tuple[str, ...] = ("OpenSimDocument",)) -> Element:
    """Parse an XML document of OpenSim. Raises `InputError` if it begins with none of the `roots`."""
    text = read_text(path)
    # declarations of entities can grow without bound, and no document of OpenSim has them
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: the file declares a document type, which is not read; export it again.")
    try:
        # names of some forces have two colons, which XML reserves
        root = ElementTree.fromstring(re.sub(r"(</?\w+)::", r"\1.", text).encode())
    except ElementTree.ParseError as error:
        raise InputError(f"{path}:{error.position[0]}: this is not XML ({error}); export it again.") from None
    if root.tag not in roots:
        raise InputError(
            f"{path}: the file begins with <{root.tag}>; expected <{roots[0]}>; give a file of OpenSim."
        )
    return root
