"""Griffe extension: fits the docstrings of gcbench to the API page."""

from __future__ import annotations

import re
from typing import Any

import griffe


class Docstrings(griffe.Extension):
    """Reads "Example:" as a section, and lists the fields of a dataclass in a table."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the heading; otherwise it would become an admonition."""
        if obj.docstring:
            text = re.sub(r"(?m)^( *)Example:\n(?= *>>>)", r"\1Examples:\n", obj.docstring.value)
            obj.docstring.value = text

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Move the docstrings of the fields into the docstring of their class."""
        if not any("dataclass" in str(d.value) for d in cls.decorators) or not cls.docstring:
            return
        fields = {n: m for n, m in cls.members.items() if m.is_attribute and not n.startswith("_")}
        fields = {n: m for n, m in fields.items() if "property" not in m.labels}
        lines = []
        for name, member in fields.items():
            text = name.replace("_", " ").capitalize() + "."
            if member.docstring:
                text = " ".join(member.docstring.value.split())
            lines.append(f"    {name} ({member.annotation}): {text}")
        if lines:
            cls.docstring.value += "\n\nAttributes:\n" + "\n".join(lines)
            for member in fields.values():
                member.docstring = None
