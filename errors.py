"""Errors that a user can cause and mend."""

from __future__ import annotations


class GcbenchError(Exception):
    """Base of every error that a user can cause and mend; the message is one line that names both.

    The command line prints it without a traceback and exits with code 2.
    """
