"""Pages as a person sees them: headless Chromium runs their scripts, takes pictures and answers questions."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox")
_BUDGET = "--virtual-time-budget=30000"  # ms of the page's own time, in which all of its scripts run


def ask(page: Path, question: str, width: int, dark: bool) -> Any:
    """The value of the JavaScript expression ``question``, which may be a promise, when the page stands."""
    if CHROMIUM is None:
        pytest.skip("needs Chromium (apt install chromium)")
    script = (
        "<script>addEventListener('load', async () => { const answer = document.createElement('pre');"
        f"try {{ answer.textContent = JSON.stringify(await ({question})); }}"
        "catch (error) { answer.textContent = JSON.stringify({error: String(error)}); }"
        "answer.id = 'answer'; document.body.append(answer); });</script>"
    )
    copy = page.with_name(f"asked_{page.name}")
    copy.write_text(page.read_text(encoding="utf-8").replace("</body>", f"{script}</body>"), encoding="utf-8")
    theme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    call = [CHROMIUM, *_OPTIONS, theme, _BUDGET, f"--window-size={width},1200", "--dump-dom", copy.as_uri()]
    done = subprocess.run(call, capture_output=True, text=True, timeout=300, check=True)
    copy.unlink()
    found = re.search(r'<pre id="answer">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    answer = json.loads(html.unescape(found[1]))
    assert not (isinstance(answer, dict) and "error" in answer), answer
    return answer
