"""Every endpoint under schemathesis: whatever comes in, what goes out is what the API's document says, and no 5xx."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any, cast

import httpx
import pytest
import schemathesis
from http_bench import serving, settings_for
from hypothesis import HealthCheck, given, settings

from service.api import create_app
from service.controller import Controller

DOCUMENT = create_app(cast(Controller, None)).openapi()
OPERATIONS = [found.ok() for found in schemathesis.openapi.from_dict(DOCUMENT).get_all_operations()]
MODES = [schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service on which runs can be started; its line leads nowhere."""
    folder = tmp_path_factory.mktemp("schema")
    configured = settings_for(folder, link={"url": str(folder / "none")}, site={"latitude_deg": 35.7})
    with serving(configured) as (_, client):
        yield str(client.base_url)


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.name.lower())
@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: operation.label)
def test_every_endpoint_keeps_to_its_document(operation: Any, mode: schemathesis.GenerationMode, address: str) -> None:
    if mode is schemathesis.GenerationMode.NEGATIVE and not (list(operation.iter_parameters()) or operation.body):
        pytest.skip("nothing about this request can be wrong")

    @settings(max_examples=10, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy(generation_mode=mode))
    def check(case: schemathesis.Case) -> None:
        if case.operation.path.endswith("/events") and (mode is MODES[0] or "limit" not in (case.query or {})):
            case.query = {"limit": 1}  # a stream has no end: one event shows that it answers
        case.call_and_validate(base_url=address, timeout=20)

    check()


def test_what_is_no_http_is_refused_as_every_endpoint_says(address: str) -> None:
    """By the server, before there is a request; a fuzzer's empty ``Content-Length`` found it in no document."""
    url = httpx.URL(address)
    with socket.create_connection((url.host, url.port or 80), timeout=20) as line:
        line.sendall(b"GET /api/v1/status HTTP/1.1\r\nHost: here\r\nContent-Length:\r\n\r\n")
        head = line.makefile("rb").read().partition(b"\r\n\r\n")[0].decode().lower()
    assert head.startswith("http/1.1 400 ")
    assert "content-type: text/plain" in head
    for methods in DOCUMENT["paths"].values():
        for operation in methods.values():
            assert "text/plain" in operation["responses"]["400"]["content"]


def test_no_endpoint_is_left_out() -> None:
    written = {(method, path) for path, methods in DOCUMENT["paths"].items() for method in methods}
    assert {(one.method, one.path) for one in OPERATIONS} == written
