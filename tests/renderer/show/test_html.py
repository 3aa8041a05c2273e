"""Whatever the data of a page say, they stay data."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import gcbench.benchmark.report
import gcbench.renderer.show
import pytest
from gcbench.errors import RenderError
from gcbench.renderer.show import html, render_page
from hypothesis import given
from hypothesis import strategies as st

TEMPLATES = (Path(str(gcbench.renderer.show.__file__)).with_name("show.html"),
             Path(str(gcbench.benchmark.report.__file__)).with_name("report.html"))
HOSTILE = st.sampled_from(("</script>", "<!--", "<script>", "]]>", "&lt;", "\u2028", "\ud800", "'",
                           '"', "PAGE_DATA", "SCRIPT_SHA256", "\\u003c", "\0"))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text() | HOSTILE,
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | HOSTILE, inner))


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.name)
@given(data=st.dictionaries(st.text() | HOSTILE, VALUES | HOSTILE))
@pytest.mark.ci
def test_data_come_back_and_end_no_element(template: Path, data: dict[str, Any]) -> None:
    page = render_page(template, data)
    page.encode()
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found and json.loads(found[1]) == data
    assert page.count("</script") == 2
    assert page.count("<script") == 2
    script = page.rpartition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page


def test_numbers_are_finite_and_size_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        render_page(TEMPLATES[0], {"x": float("nan")})
    monkeypatch.setattr(html, "_MAX_BYTES", 10)
    with pytest.raises(RenderError, match="larger"):
        render_page(TEMPLATES[0], {"x": "y" * 10})
