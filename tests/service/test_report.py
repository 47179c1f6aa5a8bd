"""The report: everything that a reader years later needs, from result.json alone, byte for byte the same again."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from forked import inertrim

from drivers.recording import read_recording
from inertial.documents import Result, parse_document
from service.compensate import compensate
from service.print_page import browser
from service.report import render
from simulators.scenarios import demo_model, demo_scenario
from simulators.simulate import simulate_recording

SECTIONS = (
    *("Identity", "Terms added to the readings", "Verification on fresh data", "Navigation error to expect at rest"),
    *("What the run could not see", "Site and reference", "Alignment", "Time used", "Covariance of the terms"),
    *("Correlation of the terms", "Noise of the block", "Go / no-go when it was concluded"),
    *("Block and circumstances", "Inputs", "Signatures"),
)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    scenario = demo_scenario(2).warmed_up()
    scenario = scenario.with_motion([], 300.0)
    name = simulate_recording(scenario, tmp_path_factory.mktemp("report") / "run", model=demo_model(2))
    return compensate(read_recording(name))


class Page(HTMLParser):
    """Collects what could reach outside, tags, and the text of the page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.outside: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.outside += [f"{name}={value}" for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"


def test_the_page_stands_alone_and_says_it_all(result: Result) -> None:
    html = render(result)
    page = Page(html)
    assert page.outside == []
    assert "script" not in page.tags
    assert not re.search(r"url\(|@import|https?://", html)
    assert re.findall(r"<h2>(.*?)</h2>", html) == list(SECTIONS)
    assert result.sha256() in page.text
    for reason in result.reasons:
        assert reason in page.text
    for digest in result.inputs.values():
        assert digest in page.text
    for entry in result.unobservable:
        assert entry.text in page.text
    for row, name in zip(result.covariance, result.order, strict=True):
        assert name in page.text
        assert all(value is None or f"{value:.3e}" in page.text for value in row)
    assert f"{result.terms['final'].g_radps[1] * 206264.80624709636:+.4f}" in page.text


def test_the_same_result_gives_the_same_bytes_also_from_its_file_and_another_process(
    result: Result, tmp_path: Path
) -> None:
    written = tmp_path / "result.json"
    written.write_text(result.canonical_json())
    assert render(parse_document(Result, written.read_bytes(), "result.json")) == render(result)
    command = [sys.executable, "-m", "service.cli", "report", str(written), "--out", str(tmp_path / "page.html")]
    assert subprocess.run(command, timeout=60, check=False).returncode == 0
    assert (tmp_path / "page.html").read_text() == render(result)


@pytest.fixture
def printable() -> None:
    if browser() is None:
        pytest.skip("no chromium on PATH (Debian: apt install chromium)")


@pytest.mark.usefixtures("printable")
def test_it_prints(result: Result, tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    written.write_text(result.canonical_json())
    files = ["--out", str(tmp_path / "page.html"), "--pdf", str(tmp_path / "page.pdf")]
    ran = inertrim("report", written, *files)
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF-")


def test_without_a_browser_the_pdf_is_refused_with_the_remedy(result: Result, tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    written.write_text(result.canonical_json())
    files = ["--out", str(tmp_path / "page.html"), "--pdf", str(tmp_path / "page.pdf")]
    ran = inertrim("report", written, *files, PATH=str(tmp_path))
    assert ran.returncode == 2
    assert "apt install chromium" in ran.stderr
    assert (tmp_path / "page.html").is_file()
