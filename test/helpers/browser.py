"""Evaluation of JavaScript expressions in a page by headless Chromium."""

import html
import json
import re
from pathlib import Path
from typing import Any

import pytest

from chromium import CHROMIUM, document


def needs_browser() -> None:
    """Skip the test without Chromium."""
    if CHROMIUM is None:
        pytest.skip("needs Chromium (apt install chromium)")


def ask(page: Path, question: str, width: int, dark: bool) -> Any:
    """Value of the JavaScript expression ``question``, which may be a promise, after the page is complete."""
    needs_browser()
    script = (
        "<script>addEventListener('load', async () => { const answer = document.createElement('pre');"
        f"try {{ answer.textContent = JSON.stringify(await ({question})); }}"
        "catch (error) { answer.textContent = JSON.stringify({error: String(error)}); }"
        "answer.id = 'answer'; document.body.append(answer); });</script>"
    )
    copy = page.with_name(f"asked_{page.name}")
    copy.write_text(page.read_text(encoding="utf-8").replace("</body>", f"{script}</body>"), encoding="utf-8")
    shown = document(copy, width, dark)
    copy.unlink()
    found = re.search(r'<pre id="answer">(.*?)</pre>', shown, re.DOTALL)
    assert found, "the page did not answer"
    answer = json.loads(html.unescape(found[1]))
    assert not (isinstance(answer, dict) and "error" in answer), answer
    return answer
