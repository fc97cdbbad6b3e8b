"""Headless Chromium: pages as a person sees them, as pictures or as what their scripts have made of them."""

import shutil
import subprocess
from pathlib import Path

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--enable-unsafe-swiftshader")
_BUDGET = "--virtual-time-budget=30000"  # ms of the page's own time, in which all of its scripts run


def _run(page: Path, size: tuple[int, int], dark: bool, *what: str) -> str:
    assert CHROMIUM is not None
    theme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    window = f"--window-size={size[0]},{size[1]}"
    call = [CHROMIUM, *_OPTIONS, theme, _BUDGET, window, *what, page.resolve().as_uri()]
    return subprocess.run(call, capture_output=True, text=True, timeout=300, check=True).stdout


def picture(page: Path, path: Path, size: tuple[int, int], dark: bool = False) -> None:
    """Write what a window of ``size`` (width, height) shows of ``page`` to ``path``, a PNG."""
    _run(page, size, dark, f"--screenshot={path.resolve()}")


def document(page: Path, width: int, dark: bool = False) -> str:
    """The document as it stands when all scripts have run."""
    return _run(page, (width, 1200), dark, "--dump-dom")
