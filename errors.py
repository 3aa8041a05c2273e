"""Errors that a user can cause and fix.

Every message is one line that names the cause and the fix. The command line prints it without a
traceback and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable


def printable(text: str) -> str:
    """Return text with escapes for the characters that a terminal obeys or cannot print.

    These are control characters other than line ends and tabs, marks of the writing direction and
    lone surrogates: names in files and of files may hold them.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode()
                   for c in text)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return " (perhaps you meant X)" for the known name that is nearest to `name`, else ""."""
    from difflib import get_close_matches

    near = get_close_matches(name, list(known), 1)
    return f" (perhaps you meant {near[0]})" if near else ""


class GcbenchError(Exception):
    """Base of all errors that a user can cause and fix."""

    def __str__(self) -> str:
        return printable(super().__str__())


class ConfigError(GcbenchError):
    """An option, a configuration file or an argument is invalid."""


class ModelError(GcbenchError):
    """A robot or object model cannot be found, read or used."""


class DatasetError(GcbenchError):
    """A dataset, a results folder or another file of data is missing, damaged or inconsistent."""


class StorageError(DatasetError):
    """Object storage does not answer, or refuses. It says nothing about the data."""


class MethodError(GcbenchError):
    """A method cannot be loaded or run, or what it returns is invalid."""


class RenderError(GcbenchError):
    """This machine cannot render, or a sequence cannot be rendered."""
