"""Reports of these tests hold no published rows."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def no_published_rows() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in ("report", "report.page"):
            patch.setattr(f"gcbench.benchmark.{module}.published_lines", lambda folder: [])
        yield
