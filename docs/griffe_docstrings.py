"""Griffe extension: fits the docstrings of gcbench to the API page."""

from __future__ import annotations

import ast
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

    def on_function(self, *, func: griffe.Function, **_: Any) -> None:
        """Show no value of a default that is not public."""
        for parameter in func.parameters:
            if re.match(r"_\w", str(parameter.default)):
                parameter.default = "..."

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """Move the docstrings of the fields into the docstring of their class."""
        if not any("dataclass" in str(d.value) for d in cls.decorators) or not cls.docstring:
            return
        fields = {n: m for n, m in cls.members.items() if m.is_attribute and not n.startswith("_")}
        fields = {n: m for n, m in fields.items() if "property" not in m.labels}
        for member in fields.values():
            member.annotation = _annotation(str(member.annotation), cls)
            if "default_factory" in str(member.value):
                member.value = "..."
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


class _Plain(ast.NodeTransformer):
    """Leaves out the bounds of annotations."""

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        if ast.unparse(node.value) == "Annotated" and isinstance(node.slice, ast.Tuple):
            return self.visit(node.slice.elts[0])
        self.generic_visit(node)
        return node


def _annotation(text: str, cls: griffe.Class) -> str:
    """An annotation without bounds, and without names that are not public."""
    aliases = {n: m.value for n, m in cls.module.members.items() if isinstance(m, griffe.Attribute)}
    text = re.sub(r"\b_[A-Z]\w+", lambda m: str(aliases.get(m[0], m[0])), text)
    text = re.sub(r"\bAnyPath\b", "str | Path", text)
    return ast.unparse(_Plain().visit(ast.parse(text, mode="eval"))).replace("'", '"')
