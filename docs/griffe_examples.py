"""Griffe extension: reads "Example:" in a docstring as the section "Examples:"."""

from __future__ import annotations

import re
from typing import Any

import griffe


class ExampleSections(griffe.Extension):
    """Renames the heading before the docstring is parsed; otherwise it would be an admonition."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            text = re.sub(r"(?m)^( *)Example:\n(?= *>>>)", r"\1Examples:\n", obj.docstring.value)
            obj.docstring.value = text
