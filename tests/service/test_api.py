"""The API over a real socket, without a block: statuses, refusals, audit, idempotency, events (docs/api.md)."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from http_bench import serving, settings_for

from service.controller import Controller

STATUS_KEYS = {
    *("state", "since", "reason", "run_id", "stage", "progress", "elapsed_s", "remaining_s"),
    *("link", "age_s", "fit", "reasons", "allowed"),
}


@pytest.fixture(scope="module")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A service with no configuration at all."""
    with serving(settings_for(tmp_path_factory.mktemp("offline"))) as (_, client):
        yield client


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, httpx.Client]]:
    """A service whose line leads nowhere: a run waits in POWER_UP."""
    folder = tmp_path_factory.mktemp("waiting")
    settings = settings_for(
        folder,
        link={"url": str(folder / "no-such-device")},
        site={"latitude_deg": 35.7},
        sequence={"power_up_timeout_s": 600.0},
    )
    with serving(settings) as served:
        yield served


@pytest.fixture
def run(waiting: tuple[Controller, httpx.Client]) -> Iterator[str]:
    """A run in POWER_UP, aborted afterwards."""
    _, client = waiting
    answer = client.post("/api/v1/runs", json={"operator": "Ada"})
    assert answer.status_code == 202, answer.text
    yield answer.json()["run_id"]
    client.post(f"{answer.headers['Location']}/abort")


def problem(answer: httpx.Response, status: int) -> dict:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["title"]
    assert body["detail"]
    return body


# ------------------------------------------------------------------ reading


def test_without_configuration_it_is_offline_and_says_what_is_missing(offline: httpx.Client) -> None:
    status = offline.get("/api/v1/status").json()
    assert set(status) >= STATUS_KEYS
    assert (status["state"], status["link"], status["fit"], status["allowed"]) == ("OFFLINE", "DISCONNECTED", False, [])
    assert any("[link] url" in reason for reason in status["reasons"])
    refused = problem(offline.post("/api/v1/runs", json={}), 409)
    assert "[site] latitude_deg" in refused["detail"]
    assert refused["allowed"] == []


def test_status_carries_an_etag_and_answers_304(offline: httpx.Client) -> None:
    for _ in range(20):  # the status is made anew twenty times a second
        first = offline.get("/api/v1/status")
        second = offline.get("/api/v1/status", headers={"If-None-Match": first.headers["ETag"]})
        if second.status_code == 304:
            break
    assert second.status_code == 304
    assert second.content == b""


def test_probes_live_apart(offline: httpx.Client, waiting: tuple[Controller, httpx.Client]) -> None:
    for prefix in ("", "/api/v1"):
        assert offline.get(f"{prefix}/healthz").json() == {"ok": True, "reasons": []}
        assert offline.get(f"{prefix}/readyz").status_code == 503
        assert waiting[1].get(f"{prefix}/readyz").status_code == 200


def test_metrics_are_read_by_prometheus_own_parser(waiting: tuple[Controller, httpx.Client]) -> None:
    from prometheus_client.parser import text_string_to_metric_families

    text = waiting[1].get("/metrics").text
    families = {family.name: family for family in text_string_to_metric_families(text)}
    assert sum(sample.value for sample in families["inertrim_state"].samples) == 1
    assert "inertrim_line_frames_lost" in families
    assert families["inertrim_line_open_failures"].samples[0].value > 0


def test_the_document_of_the_api_names_every_route(offline: httpx.Client) -> None:
    paths = offline.get("/api/v1/openapi.json").json()["paths"]
    wanted = "status runs runs/{run_id} runs/{run_id}/abort runs/{run_id}/acknowledge runs/{run_id}/result "
    wanted += "runs/{run_id}/report runs/{run_id}/samples events calibrations models healthz readyz metrics"
    assert {f"/api/v1/{name}" for name in wanted.split()} <= set(paths)


# ------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/api/v1/runs/unknown", 404),
        ("GET", "/api/v1/runs/..%2f..%2fetc%2fpasswd/samples", 404),
        ("GET", "/api/v1/calibrations/..%2f..%2fsecret", 404),
        ("POST", "/api/v1/runs/unknown/abort", 404),
        ("DELETE", "/api/v1/runs", 405),
        ("GET", "/api/v1/runs?limit=0", 422),
        ("GET", "/api/v1/events?limit=zero", 422),
    ],
)
def test_every_error_is_a_problem(offline: httpx.Client, method: str, path: str, status: int) -> None:
    problem(offline.request(method, path), status)


@pytest.mark.parametrize(
    ("body", "place"),
    [
        ({"azimuth_rad": 1.0}, "azimuth_rad"),
        ({"azimuth_deg": "north"}, "azimuth_deg"),
        ({"azimuth_deg": 400.0}, "azimuth_deg"),
        ({"method": "guess"}, "method"),
        ({"operator": "a\nb"}, "operator"),
        ([], "body"),
    ],
)
def test_a_wrong_body_is_refused_by_name(waiting: tuple[Controller, httpx.Client], body: object, place: str) -> None:
    refused = problem(waiting[1].post("/api/v1/runs", json=body), 422)
    assert place in refused["errors"][0]["place"]


def test_a_body_that_is_too_large_is_refused(waiting: tuple[Controller, httpx.Client]) -> None:
    headers = {"Content-Type": "application/json"}
    pieces = (b"[" * 10_000 for _ in range(10))  # no length announced
    problem(waiting[1].post("/api/v1/runs", content=b"[" * 100_000, headers=headers), 413)
    problem(waiting[1].post("/api/v1/runs", content=pieces, headers=headers), 413)


def test_a_body_of_not_a_number_is_refused(waiting: tuple[Controller, httpx.Client]) -> None:
    headers = {"Content-Type": "application/json"}
    problem(waiting[1].post("/api/v1/runs", content=b'{"azimuth_deg": NaN}', headers=headers), 422)


# ------------------------------------------------------------------ commands


def test_a_run_is_accepted_with_its_address_and_followed_there(
    waiting: tuple[Controller, httpx.Client], run: str
) -> None:
    _, client = waiting
    detail = client.get(f"/api/v1/runs/{run}").json()
    assert (detail["state"], detail["operator"], detail["method"]) == ("POWER_UP", "Ada", "optimal")
    assert client.get("/api/v1/status").json()["run_id"] == run
    assert client.get("/api/v1/runs").json()["runs"][0]["run_id"] == run


def test_a_second_run_is_refused_with_what_is_allowed(waiting: tuple[Controller, httpx.Client], run: str) -> None:
    _, client = waiting
    refused = problem(client.post("/api/v1/runs", json={}), 409)
    assert refused["allowed"] == ["abort"]
    assert refused["state"] == "POWER_UP"
    assert refused["type"] == "urn:inertrim:problem:not-allowed"
    assert client.get("/api/v1/status").json()["run_id"] == run


def test_acknowledging_what_is_no_fault_is_refused(waiting: tuple[Controller, httpx.Client], run: str) -> None:
    assert problem(waiting[1].post(f"/api/v1/runs/{run}/acknowledge"), 409)["allowed"] == ["abort"]


def test_abort_ends_the_run_once(waiting: tuple[Controller, httpx.Client], run: str) -> None:
    controller, client = waiting
    answer = client.post(f"/api/v1/runs/{run}/abort", json={"operator": "Grace", "reason": "wrong azimuth"})
    assert answer.status_code == 202
    problem(client.post(f"/api/v1/runs/{run}/abort"), 409)
    deadline = time.monotonic() + 5
    while (detail := client.get(f"/api/v1/runs/{run}").json())["ended"] is None:
        assert time.monotonic() < deadline
    assert (detail["state"], detail["reason"]) == ("ABORTED", "operator")
    assert detail["transitions"][-1]["detail"] == "by Grace: wrong azimuth"
    for what in ("result", "report"):
        assert problem(client.get(f"/api/v1/runs/{run}/{what}"), 404)["type"] == f"urn:inertrim:problem:no-{what}"
    commands = [(one["command"], one["who"], one["outcome"]) for one in controller.store.audit_log(3)]
    assert ("abort", "Grace", "accepted") in commands
    assert any(command == "abort" and outcome == "refused" for command, _, outcome in commands)


def test_the_same_key_starts_one_run(waiting: tuple[Controller, httpx.Client]) -> None:
    _, client = waiting
    headers = {"Idempotency-Key": f"key-{time.monotonic_ns()}"}

    def ask(_: int) -> httpx.Response:
        return client.post("/api/v1/runs", json={"operator": "Ada"}, headers=headers)

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(ask, range(8)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.json()["run_id"] for answer in answers}) == 1
    other = client.post("/api/v1/runs", json={"operator": "Grace"}, headers=headers)
    assert problem(other, 422)["type"] == "urn:inertrim:problem:idempotency-key-reused"
    client.post(f"{answers[0].headers['Location']}/abort")
    again = ask(0)  # the run is over: the key still means that run and starts none
    assert again.json()["run_id"] == answers[0].json()["run_id"]
    assert client.get("/api/v1/status").json()["state"] == "ABORTED"


def test_runs_are_listed_by_pages(waiting: tuple[Controller, httpx.Client]) -> None:
    _, client = waiting
    for _ in range(5):
        answer = client.post("/api/v1/runs", json={})
        client.post(f"{answer.headers['Location']}/abort")
    everything = [one["run_id"] for one in client.get("/api/v1/runs?limit=200").json()["runs"]]
    paged, address = [], "/api/v1/runs?limit=2"
    while address:
        page = client.get(address).json()
        paged += [one["run_id"] for one in page["runs"]]
        address = page["next"]
    assert paged == everything
    assert everything == sorted(everything, reverse=True)


# ------------------------------------------------------------------ events


def events_of(response: httpx.Response) -> Iterator[tuple[str, dict]]:
    kind = ""
    for line in response.iter_lines():
        if line.startswith("event: "):
            kind = line.removeprefix("event: ")
        elif line.startswith("data: "):
            yield kind, json.loads(line.removeprefix("data: "))


def test_events_begin_with_the_status_and_tell_changes(waiting: tuple[Controller, httpx.Client]) -> None:
    controller, client = waiting
    with client.stream("GET", "/api/v1/events") as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        stream = events_of(response)
        kind, status = next(stream)
        assert kind == "status"
        assert set(status) >= STATUS_KEYS
        while len(controller.hub) == 0:
            time.sleep(0.01)
        run = httpx.post(client.base_url.join("/api/v1/runs"), json={}).json()
        changes = (data for kind, data in stream if kind == "state")
        change = next(changes)
        assert (change["target"], change["run_id"]) == ("POWER_UP", run["run_id"])
        httpx.post(client.base_url.join(f"{run['location']}/abort"))
        assert next(changes)["target"] == "ABORTED"
    deadline = time.monotonic() + 10
    while len(controller.hub):  # a client that has gone is forgotten
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_client_that_does_not_read_costs_nobody_anything(waiting: tuple[Controller, httpx.Client]) -> None:
    controller, client = waiting
    with client.stream("GET", "/api/v1/events"):
        while len(controller.hub) == 0:
            time.sleep(0.01)
        began = time.perf_counter()
        for number in range(5_000):
            controller.hub.publish("samples", {"number": number, "filling": "x" * 500})
        assert time.perf_counter() - began < 5.0
        assert client.base_url
        assert httpx.get(client.base_url.join("/api/v1/status")).status_code == 200


# ------------------------------------------------------------------ a service that has lost its thread


def test_a_dead_acquisition_is_never_shown_as_good(tmp_path) -> None:  # type: ignore[no-untyped-def]
    settings = settings_for(tmp_path, link={"url": str(tmp_path / "none")}, site={"latitude_deg": 1.0})
    with serving(settings) as (controller, client):
        controller._acquisition._stopping.set()
        time.sleep(2.6)
        status = client.get("/api/v1/status").json()
        assert status["fit"] is False
        assert status["link"] == "STALE"
        assert "acquisition" in status["reasons"][0]
        assert client.get("/healthz").status_code == 503
