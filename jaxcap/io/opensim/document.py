"""XML documents of OpenSim."""

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from ...errors import InputError
from ..text import read_text

#: largest number of characters of a name
LONGEST_NAME = 200


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
    long = max((len(element.get("name", "")) for element in root.iter()), default=0)
    if long > LONGEST_NAME:
        raise InputError(f"{path}: a name has {long} characters; expected at most {LONGEST_NAME}; rename it.")
    return root
