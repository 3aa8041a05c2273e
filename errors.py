"""Errors that a user can cause and fix.

Every message is one line that names the cause and the fix. The command line prints it without a
traceback and exits with code 2.
"""

from __future__ import annotations


class GcbenchError(Exception):
    """Base of all errors that a user can cause and fix."""


class ConfigError(GcbenchError):
    """An option, a configuration file or an argument is invalid."""


class ModelError(GcbenchError):
    """A robot or object model cannot be found, read or used."""


class DatasetError(GcbenchError):
    """A dataset, a results folder or another file of data is missing, damaged or inconsistent."""


class MethodError(GcbenchError):
    """A method cannot be loaded or run, or what it returns is invalid."""


class RenderError(GcbenchError):
    """This machine cannot render, or a sequence cannot be rendered."""
