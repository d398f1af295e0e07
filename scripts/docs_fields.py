"""Fields' remarks, `#: metres`, as their docstrings in the reference; an extension of griffe, which mkdocstrings reads code by."""

from typing import Any

import griffe


class FieldRemarks(griffe.Extension):
    """Read the comment above a field, from `#:` on."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **others: Any) -> None:
        """Add the comment of an attribute as its docstring."""
        del others
        if attr.docstring is not None or attr.lineno is None or not attr.lines_collection:
            return
        lines = attr.lines_collection[attr.filepath]
        last = first = attr.lineno - 1
        while first > 0 and lines[first - 1].strip().startswith("#"):
            first -= 1
        remarks = [line.strip() for line in lines[first:last]]
        while remarks and not remarks[0].startswith("#:"):
            remarks.pop(0)
        if remarks:
            text = " ".join(remark.lstrip("#:").strip() for remark in remarks)
            attr.docstring = griffe.Docstring(text, lineno=first + 1, parent=attr)
