"""What machines watch: metrics named by the conventions, read from the running service; log lines one object each."""

from __future__ import annotations

import io
import json
import logging
import math
import re
import shutil
import subprocess
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import structlog
import yaml
from http_bench import serving, settings_for
from prometheus_client.parser import text_string_to_metric_families
from sequencer_bench import TERMS, result

from drivers.samples import empty_samples
from service.config import LogSettings, Settings
from service.controller import Controller
from service.estimation import RunPlan, final_result, keep_recording, terms_so_far, write_result
from service.logs import configure_logs, correlate
from service.orders import Estimate, Keep
from service.run_folder import RunFolder
from service.security.roles import Role
from service.security.tokens import make_token
from service.sequencer import RunContext

BASE_UNITS = (
    "seconds",
    "bytes",
    "ratio",
    "celsius",
    "volts",
    "info",
    "radians_per_second",
    "meters_per_second_squared",
)
"""https://prometheus.io/docs/practices/naming: base units only."""
NOT_BASE = re.compile(r"_(ms|milliseconds|minutes|hours|days|kilobytes|megabytes|mb|percent|deg|degrees|g|mg|dph)(_|$)")
"""What promtool's lint refuses, and the units that the rest of this program has at its faces."""
Serving = tuple[Controller, httpx.Client]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    folder = tmp_path_factory.mktemp("metrics")
    settings = settings_for(folder, link={"url": str(folder / "none")}, site={"latitude_deg": 35.7})
    with serving(settings) as both:
        yield both


def families(client: httpx.Client) -> dict[str, Any]:
    answer = client.get("/metrics")
    assert answer.status_code == 200
    return {family.name: family for family in text_string_to_metric_families(answer.text)}


def test_names_types_and_units_keep_the_conventions(service: Serving) -> None:
    for name, family in families(service[1]).items():
        assert re.fullmatch(r"[a-z][a-z0-9_]*", name), name
        ours = name.startswith("inertrim_")
        assert family.documentation.endswith(".") or not ours, f"{name}: no sentence says what it is"
        assert not NOT_BASE.search(name), f"{name}: not a base unit"
        for sample in family.samples:
            assert sample.name.endswith("_total") == (family.type == "counter"), sample.name
            assert not {"le", "quantile"} & set(sample.labels) or family.type == "histogram"
        if ours and re.search(r"_(seconds|bytes|ratio)_", f"{name}_"):
            assert name.endswith(BASE_UNITS), f"{name}: the unit comes last"
        kinds = ("counter", "gauge", "histogram", "info")
        assert not any(part in kinds for part in name.removesuffix("_info").split("_")), f"{name}: the type is no part"


def test_what_the_service_counts_is_told(service: Serving) -> None:
    controller, client = service
    found = families(client)
    assert {sample.labels["state"] for sample in found["inertrim_state"].samples if sample.value} == {"OFFLINE"}
    assert found["inertrim_fit"].samples[0].value == 0
    assert math.isnan(found["inertrim_frame_age_seconds"].samples[0].value)
    assert math.isnan(found["inertrim_verification_chi_squared"].samples[0].value)
    assert found["inertrim_line_open_failures"].samples[0].value > 0
    assert found["inertrim_acquisition_silence_seconds"].samples[0].value < 2.0
    assert {one.labels["queue"] for one in found["inertrim_queue_items"].samples} == {"worker", "recorder", "line"}
    assert found["inertrim_disk_free_bytes"].samples[0].value > 0
    assert found["process_resident_memory_bytes"].samples[0].value > 1e6
    names = {one["name"] for one in controller.conditions()["conditions"]}
    assert {one.labels["condition"] for one in found["inertrim_condition_broken"].samples} == names


def test_a_run_s_terms_and_verification_are_told(tmp_path: Path) -> None:
    with serving(settings_for(tmp_path)) as (controller, client):
        verified = result().model_copy(update={"verification": {"chi_square": 7.5, "limit": 22.5}})
        run = RunContext("run-1", terms={"stage_1": TERMS}, result=verified)
        controller._sequencer._run = run  # a run of five minutes is not waited for
        deadline_s = time.monotonic() + 10.0
        while controller.status().facts["run_id"] != "run-1":  # the status is made anew twenty times a second
            assert time.monotonic() < deadline_s
        found = families(client)
    for name, told in (
        ("accel_term_meters_per_second_squared", TERMS.f_mps2),
        ("gyro_term_radians_per_second", TERMS.g_radps),
    ):
        samples = found[f"inertrim_{name}"].samples
        assert {(one.labels["stage"], one.labels["axis"]): one.value for one in samples} == {
            ("stage_1", axis): value for axis, value in zip("xyz", told, strict=True)
        }
    assert found["inertrim_verification_chi_squared"].samples[0].value == 7.5
    assert found["inertrim_verification_chi_squared_limit"].samples[0].value == 22.5


def test_work_that_hangs_is_told_and_makes_the_service_unhealthy(
    service: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, client = service
    release = threading.Event()
    controller._worker.submit(lambda: release.wait(60.0) and None)  # a disk that does not answer
    try:
        monkeypatch.setattr("service.controller.HANGS_AFTER_S", 0.05)
        deadline_s = time.monotonic() + 20.0
        while (answer := client.get("/healthz")).status_code == 200:
            assert time.monotonic() < deadline_s
        assert "one piece of work" in answer.text
        assert families(client)["inertrim_worker_busy_seconds"].samples[0].value > 0.05
    finally:
        release.set()
    while client.get("/healthz").status_code != 200:
        assert time.monotonic() < deadline_s + 20.0


def test_requests_are_timed_by_route_and_guessed_paths_make_no_series(service: Serving) -> None:
    client = service[1]
    for path in ("/api/v1/status", "/api/v1/runs/unknown", "/guess/1", "/guess/2"):
        client.get(path)
    counts = {
        (one.labels["route"], one.labels["code"]): one.value
        for one in families(client)["inertrim_http_request_duration_seconds"].samples
        if one.name.endswith("_count")
    }
    assert counts["/status", "200"] == 1
    assert counts["/runs/{run_id}", "404"] == 1
    assert counts["none", "404"] == 2


def test_every_metric_is_in_the_documentation(service: Serving) -> None:
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()
    told = set(re.findall(r"`(inertrim_[a-z_]+)`", page))
    exported = {
        f"{name}_total" if family.type == "counter" else f"{name}_info" if family.type == "info" else name
        for name, family in families(service[1]).items()
        if name.startswith("inertrim_")
    }
    assert told == exported


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    handlers, level, configured = logging.root.handlers[:], logging.root.level, structlog.get_config()
    stream = io.StringIO()
    configure_logs(LogSettings(), stream)
    yield stream
    correlate(None)
    logging.captureWarnings(False)
    logging.root.handlers[:] = handlers
    logging.root.setLevel(level)
    structlog.configure(**configured)


def test_every_line_is_one_object_and_bears_the_run_in_hand(lines: io.StringIO) -> None:
    structlog.get_logger().info("before")
    correlate("run-1")
    structlog.get_logger().warning("state", target="READY")
    logging.getLogger("sqlalchemy.pool").error("a library's line, %d", 7)
    try:
        raise ValueError("what went wrong")
    except ValueError:
        structlog.get_logger().exception("worker")
    warnings.warn("a warning of Python's", RuntimeWarning, stacklevel=1)
    before, state, library, worker, warning = (json.loads(line) for line in lines.getvalue().splitlines())
    assert "run_id" not in before
    assert [one["run_id"] for one in (state, library, worker, warning)] == ["run-1"] * 4
    assert "RuntimeWarning: a warning of Python's" in warning["event"]
    assert (state["event"], state["level"], state["target"]) == ("state", "warning", "READY")
    assert library["event"] == "a library's line, 7"
    assert worker["exception"][0]["exc_value"] == "what went wrong"
    assert all("timestamp" in one for one in (before, state, library, worker))


def test_lines_of_the_process_beside_the_service_bear_the_run_too(
    lines: io.StringIO, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def told(*_: object, **__: object) -> None:
        logging.getLogger("a library").warning("told")

    monkeypatch.setattr("service.estimation.compensate", told)
    monkeypatch.setattr("service.estimation.partial", told)
    monkeypatch.setattr("service.estimation.render", lambda _: told() or "")
    monkeypatch.setattr(RunFolder, "write_recording", told)
    monkeypatch.setattr(RunPlan, "meta", lambda *_: None)
    known, samples = Settings(), empty_samples(2, 1)
    for run_id, work, order in (
        ("run-0", terms_so_far, Estimate(1, "run-0", (), (), samples, False)),
        ("run-1", final_result, Estimate(1, "run-1", (), (), samples, True)),
        ("run-2", keep_recording, Keep("run-2", (), (), samples)),
    ):
        work(RunPlan("optimal", known.site, known.reference, RunFolder(tmp_path, run_id), known.block), order)
    (tmp_path / "run-3").mkdir()
    write_result(RunFolder(tmp_path, "run-3"), result())
    marks = [json.loads(line)["run_id"] for line in lines.getvalue().splitlines()]
    assert list(dict.fromkeys(marks)) == ["run-0", "run-1", "run-2", "run-3"]


def test_lines_for_a_console_are_text(lines: io.StringIO) -> None:
    configure_logs(LogSettings(format="console", level="warning"), lines)
    structlog.get_logger().info("not this")
    structlog.get_logger().warning("capture", path="capture.raw")
    assert lines.getvalue().count("\n") == 1
    assert re.search(r"warning.*capture.*path=capture\.raw", lines.getvalue())


def test_a_line_that_cannot_be_written_hurts_nobody(lines: io.StringIO) -> None:
    lines.close()
    structlog.get_logger().error("capture", path="capture.raw")


DEPLOY = Path(__file__).parents[2] / "deploy"
SERIES = re.compile(r"\b((?:inertrim|process)_[a-z_]+)")


@pytest.mark.parametrize("file", ["prometheus/alerts.yml", "grafana/inertrim.json"])
def test_alerts_and_dashboard_name_only_what_the_service_exports(service: Serving, file: str) -> None:
    text = (DEPLOY / file).read_text()
    if file.endswith(".yml"):
        rules = [rule for group in yaml.safe_load(text)["groups"] for rule in group["rules"]]
        expressions = [rule["expr"] for rule in rules]
        assert all({"summary", "remedy"} <= set(rule["annotations"]) for rule in rules)
    else:
        board = json.loads(text)
        expressions = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
        expressions += [one["query"] for one in board["templating"]["list"] if one["type"] == "query"]
    used = {name for expression in expressions for name in SERIES.findall(expression)}
    service[1].get("/api/v1/status")  # so that the histogram has a series
    exported = {sample.name for family in families(service[1]).values() for sample in family.samples}
    # Terms have no series before a run has given some; their names stand in the text all the same.
    exported |= set(families(service[1]))
    assert used
    assert used <= exported, sorted(used - exported)


def test_labels_that_rules_ask_for_exist(service: Serving) -> None:
    """A rule on a label's value that is never told would be silent for ever."""
    text = (DEPLOY / "prometheus" / "alerts.yml").read_text() + (DEPLOY / "grafana" / "inertrim.json").read_text()
    told = {
        (key, value)
        for family in families(service[1]).values()
        for one in family.samples
        for key, value in one.labels.items()
    }
    asked = set(re.findall(r'\b(state|route|queue|target)=\\?"([^"\\]+)\\?"', text))
    assert asked
    assert asked <= told


def test_a_service_with_tokens_takes_the_one_that_the_scrape_configuration_shows(tmp_path: Path) -> None:
    commented = (DEPLOY / "prometheus" / "prometheus.yml").read_text().replace("# authorization", "authorization")
    (job,) = yaml.safe_load(commented.replace("# scheme", "scheme"))["scrape_configs"]
    assert (set(job["authorization"]), job["scheme"]) == ({"credentials_file"}, "https")
    with serving(settings_for(tmp_path)) as (controller, client):
        token, record = make_token("prometheus", Role.VIEWER)
        controller.store.add_token(record)
        deadline_s = time.monotonic() + 10.0
        while client.get(job["metrics_path"]).status_code != 401:  # the service looks every two seconds
            assert time.monotonic() < deadline_s
        given = {"Authorization": f"Bearer {token}"}  # Prometheus' own scheme where no type is named
        assert client.get(job["metrics_path"], headers=given).status_code == 200


@pytest.fixture
def promtool() -> str:
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("promtool is not installed (Debian: apt install prometheus)")
    return tool


def test_prometheus_own_lint_finds_nothing(service: Serving, promtool: str) -> None:
    for arguments, given in (
        (["check", "metrics"], service[1].get("/metrics").content),
        (["check", "config", str(DEPLOY / "prometheus" / "prometheus.yml")], b""),
        (["check", "rules", str(DEPLOY / "prometheus" / "alerts.yml")], b""),
    ):
        done = subprocess.run([promtool, *arguments], input=given, capture_output=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
