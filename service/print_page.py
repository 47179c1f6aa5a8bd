"""A page as PDF, through the print of a Chromium that is installed."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from service.errors import RefusedInput

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PRINT_S = 120.0
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-pdf-header-footer"),
)


def browser() -> str | None:
    """Return the browser that prints, None where there is none."""
    return next((found for name in BROWSERS if (found := shutil.which(name)) is not None), None)


def print_page(html: str, pdf: Path) -> None:
    """Print a self-contained page.

    Raises
    ------
    RefusedInput
        No browser is installed, or it did not print.
    """
    program = browser()
    if program is None:
        remedy = "Install one (Debian: apt install chromium), or print the HTML from any browser."
        raise RefusedInput(str(pdf), "a PDF needs Chromium, and none is on PATH.", remedy)
    with tempfile.TemporaryDirectory() as folder:
        page, made = Path(folder, "page.html"), Path(folder, "page.pdf")
        page.write_text(html, encoding="utf-8")
        command = [program, *FLAGS, f"--user-data-dir={folder}/profile", f"--print-to-pdf={made}", page.as_uri()]
        try:
            ran = subprocess.run(command, capture_output=True, text=True, timeout=PRINT_S, check=False)
        except subprocess.TimeoutExpired:
            raise RefusedInput(str(pdf), f"{program} did not print within {PRINT_S:g} s.", "Try again.") from None
        if not made.is_file():
            said = (ran.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise RefusedInput(str(pdf), f"{program} did not print: {said}.", "Print the HTML from any browser.")
        shutil.copyfile(made, pdf)
