"""Methods by name, and the baselines."""

from __future__ import annotations

from .registry import (
    Declaration,
    declaration_of,
    fingerprint_options,
    is_own,
    list_methods,
    method_identity,
    method_source,
    open_method,
    options_of,
    plan_rows,
    split_oracles,
    with_options,
)

__all__ = [
    "Declaration", "declaration_of", "fingerprint_options", "is_own", "list_methods",
    "method_identity", "method_source", "open_method", "options_of", "plan_rows", "split_oracles",
    "with_options",
]
