"""The event stream: resumed where it was cut, and never slowed by a client that does not read."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator

import httpx
import jsonschema_rs
import pytest
from http_bench import serving, settings_for

from service.controller import Controller
from service.events import QUEUE_EVENTS

FILLING = "x" * 20_000


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, httpx.Client]]:
    with serving(settings_for(tmp_path_factory.mktemp("events"))) as both:
        yield both


def told(response: httpx.Response, kind: str) -> Iterator[tuple[str, dict]]:
    """Yield id and data of the events of one kind."""
    number = found = ""
    for line in response.iter_lines():
        name, _, text = line.partition(": ")
        if name == "event":
            found = text
        elif name == "id":
            number = text
        elif name == "data":
            data = json.loads(text)
        elif not line and found == kind:
            yield number, data


def subscribed(controller: Controller, clients: int) -> None:
    end = time.monotonic() + 20
    while len(controller.hub) != clients:
        assert time.monotonic() < end, len(controller.hub)
        time.sleep(0.01)


def test_a_socket_that_never_reads_slows_nobody_and_holds_no_more_than_its_queue(
    served: tuple[Controller, httpx.Client],
) -> None:
    controller, client = served
    port = client.base_url.port
    assert port is not None
    frozen = []
    for _ in range(3):
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        connection.connect(("127.0.0.1", port))
        connection.sendall(b"GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        frozen.append(connection)
    subscribed(controller, 3)
    count, got = 800, [-1]
    with httpx.stream("GET", client.base_url.join("/api/v1/events"), timeout=60) as response:
        subscribed(controller, 4)

        def publish() -> None:
            for number in range(count):
                while number - got[-1] > QUEUE_EVENTS // 4:  # as fast as one who reads can read
                    time.sleep(0.001)
                controller.hub.publish("probe", {"number": number, "filling": FILLING})

        threading.Thread(target=publish, daemon=True).start()
        for _, data in told(response, "probe"):
            got.append(data["number"])
            if data["number"] == count - 1:
                break
    assert got == list(range(-1, count))  # the one that reads has lost nothing
    held = [client_.waiting for client_ in controller.hub._clients]
    assert max(len(waiting) for waiting in held) == QUEUE_EVENTS  # 16 MB each were sent; this much is kept
    assert client.get("/api/v1/status").status_code == 200
    for connection in frozen:
        connection.close()
    subscribed(controller, 0)


def test_a_stream_goes_on_after_the_event_that_was_seen_last(served: tuple[Controller, httpx.Client]) -> None:
    controller, client = served
    for number in range(10):
        controller.hub.publish("probe", {"number": number, "round": 1})
    controller.hub.publish("probe", {"number": 99, "round": 1})
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": "elsewhere-3"}) as response:
        probes = told(response, "probe")
        subscribed(controller, 1)
        controller.hub.publish("probe", {"number": 0, "round": 2})
        seen, data = next(probes)
        assert data["round"] == 2  # an id of another process resumes nothing
    for number in range(1, 6):
        controller.hub.publish("probe", {"number": number, "round": 2})
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": seen}) as response:
        probes = told(response, "probe")
        assert [next(probes)[1] for _ in range(5)] == [{"number": number, "round": 2} for number in range(1, 6)]


def test_only_so_much_of_the_past_is_kept(served: tuple[Controller, httpx.Client]) -> None:
    controller, _ = served
    for number in range(QUEUE_EVENTS + 100):
        controller.hub.publish("probe", {"number": number})
    assert len(controller.hub._kept) == QUEUE_EVENTS


def test_who_comes_back_is_told_of_changes_and_not_of_moments_long_gone(
    served: tuple[Controller, httpx.Client],
) -> None:
    controller, client = served
    with client.stream("GET", "/api/v1/events") as response:
        probes = told(response, "probe")
        subscribed(controller, 1)
        controller.hub.publish("probe", {"number": 0})
        seen, _ = next(probes)
    for number in range(1, 4 * QUEUE_EVENTS):
        kind = "probe" if number in (1, QUEUE_EVENTS, 3 * QUEUE_EVENTS) else "progress"
        controller.hub.publish(kind, {"number": number})
    with client.stream("GET", "/api/v1/events", headers={"Last-Event-ID": seen}) as response:
        probes = told(response, "probe")
        assert [next(probes)[1]["number"] for _ in range(3)] == [1, QUEUE_EVENTS, 3 * QUEUE_EVENTS]


def test_the_schemas_are_json_schemas_and_the_documents_keep_to_them(served: tuple[Controller, httpx.Client]) -> None:
    _, client = served
    addresses = client.get("/api/v1/schemas").json()["schemas"]
    assert {"status", "conditions", "run", "lease", "line", "result", "calibration", "block", "problem"} <= set(
        addresses
    )
    for name, address in addresses.items():
        schema = client.get(address).json()
        jsonschema_rs.meta.validate(schema)
        assert schema["$id"] == f"urn:inertrim:{name}:1"
        if name in ("status", "conditions", "runs", "lease", "line", "audit"):
            jsonschema_rs.validator_for(schema).validate(client.get(f"/api/v1/{name}").json())
    assert client.get("/api/v1/schemas/nothing").status_code == 404
