"""Self-contained HTML pages: a template with one inline script, and data that stay data."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import RenderError

_MAX_BYTES = 256 * 2**20  # browsers refuse strings of 512 MiB
_SHARED = Path(__file__).parent
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


def render_page(
    template: Path, data: Mapping[str, Any], scripts: str = "", static: str = ""
) -> str:
    """Return the page of a template file and the values that its script reads.

    Names come from untrusted models, methods and files. They enter the page as JSON in which no
    character can end the script element, and the script sets them as text. The page's content
    security policy admits this one script, by its hash, and no network address.

    Args:
        template: HTML with one inline `<script>` and the words SCRIPT_SHA256 (in the policy),
            PAGE_DATA (in an element of type application/json), and, as comments, PAGE_STYLE and
            PAGE_SCRIPT, for what all pages share. PAGE_STATIC may stand in a `<noscript>`.
        data: JSON values; numbers must be finite.
        scripts: Trusted scripts that run before that of the template.
        static: HTML for browsers without scripts, with every name escaped.

    Raises:
        RenderError: the data exceed 256 MiB.
    """
    html = template.read_text(encoding="utf-8")
    html = html.replace("/* PAGE_STYLE */", shared_text("page.css"))
    html = html.replace("// PAGE_SCRIPT", f"{shared_text('page.js')}\n{scripts}")
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    if len(text) > _MAX_BYTES:
        raise RenderError(f"the page would be larger than {_MAX_BYTES >> 20} MiB")
    for character in "<>&":  # json.dumps has escaped what is not ASCII
        text = text.replace(character, f"\\u{ord(character):04x}")
    (script,) = _SCRIPT.findall(html)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    marks = {"SCRIPT_SHA256": digest, "PAGE_STATIC": static, "PAGE_DATA": text}
    return re.sub("|".join(marks), lambda found: marks[found[0]], html)


def shared_text(name: str) -> str:
    """Return the text of a file that pages share."""
    return (_SHARED / name).read_text(encoding="utf-8")
