"""One console commands at a time: the lease by itself, and over HTTP."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from http_bench import serving, settings_for

from service.controller import Controller
from service.lease import LeaseDesk, LeaseHeld, NoSuchLease


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_the_lease_ends_by_time_by_release_and_by_take_over() -> None:
    clock = Clock()
    desk = LeaseDesk(clock)
    desk.check(None)  # nobody holds it: a single console may command
    first, _ = desk.acquire("A", 10.0)
    desk.check(first.id)
    with pytest.raises(LeaseHeld, match="A commands this service for 10 s more"):
        desk.check(None)
    with pytest.raises(LeaseHeld):
        desk.acquire("B", 10.0)
    clock.now_s = 9.0
    desk.renew(first.id, 10.0)
    clock.now_s = 18.9
    desk.check(first.id)
    clock.now_s = 19.0
    desk.check(None)
    for late in (desk.check, desk.release, lambda lease_id: desk.renew(lease_id, 1.0)):
        with pytest.raises(NoSuchLease):
            late(first.id)
    second, before = desk.acquire("A", 10.0)
    assert before is None
    third, before = desk.acquire("B", 10.0, take_over=True)
    assert before == "A"
    with pytest.raises(LeaseHeld):
        desk.check(second.id)
    desk.release(third.id)
    assert desk.current() is None


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, httpx.Client]]:
    folder = tmp_path_factory.mktemp("lease")
    link, site = {"url": str(folder / "none")}, {"latitude_deg": 35.7}
    with serving(settings_for(folder, link=link, site=site, sequence={"power_up_timeout_s": 600.0})) as both:
        yield both


def test_while_one_console_holds_the_lease_the_others_watch(served: tuple[Controller, httpx.Client]) -> None:
    controller, client = served
    lease = client.post("/api/v1/lease", json={"holder": "north", "lasts_s": 60}).json()
    mine = {"Lease-Id": lease["lease_id"]}
    held = client.post("/api/v1/runs", json={"operator": "south"})
    assert held.status_code == 423
    assert held.json()["holder"] == "north"
    assert held.headers["content-type"] == "application/problem+json"
    assert client.get("/api/v1/status").json()["state"] == "OFFLINE"
    assert client.post("/api/v1/lease", json={"holder": "south"}).status_code == 409

    run = client.post("/api/v1/runs", json={"operator": "north"}, headers=mine)
    assert run.status_code == 202
    assert client.post(f"{run.headers['Location']}/abort").status_code == 423
    assert client.get("/api/v1/lease").json()["holder"] == "north"

    taken = client.post("/api/v1/lease", json={"holder": "south", "take_over": True, "reason": "north is gone"}).json()
    assert taken["taken_over_from"] == "north"
    theirs = {"Lease-Id": taken["lease_id"]}
    assert client.post(f"{run.headers['Location']}/abort", headers=mine).status_code == 423
    assert client.put("/api/v1/lease", json={}, headers=mine).status_code == 409
    assert client.post(f"{run.headers['Location']}/abort", headers=theirs).status_code == 202
    assert client.delete("/api/v1/lease", headers=theirs).status_code == 204
    assert client.post(f"{run.headers['Location']}/abort", headers=theirs).json()["type"].endswith("lease-lost")
    assert client.get("/api/v1/lease").json() == {"holder": None, "left_s": None}

    audit = [(one["who"], one["command"], one["outcome"], one["detail"]) for one in controller.store.audit_log()]
    assert ("south", "take over the lease", "accepted", "from north: north is gone") in audit
    assert ("south", "release the lease", "accepted", "") in audit
    assert any(command == "acquire the lease" and outcome == "refused" for _, command, outcome, _ in audit)


def test_an_acknowledgement_is_a_command_with_name_and_reason(served: tuple[Controller, httpx.Client]) -> None:
    controller, client = served
    path = "/api/v1/conditions/frames_fresh/acknowledge"
    assert client.post(path, json={"operator": "Ada"}).status_code == 422
    assert client.post(path, json={"operator": "Ada", "reason": ""}).status_code == 422
    told = client.post(path, json={"operator": "Ada", "reason": "cable is being changed"}).json()
    assert (told["state"], told["acknowledgement"]["by"]) == ("failed", "Ada")  # critical: known, and still against
    assert client.post("/api/v1/conditions/clock/acknowledge", json={"operator": "A", "reason": "b"}).status_code == 409
    assert client.post("/api/v1/conditions/moon/acknowledge", json={"operator": "A", "reason": "b"}).status_code == 404
    newest = controller.store.audit_log(2)
    assert [(one["command"], one["outcome"]) for one in newest] == [
        ("acknowledge clock", "refused"),
        ("acknowledge frames_fresh", "accepted"),
    ]
    conditions, status = client.get("/api/v1/conditions").json(), client.get("/api/v1/status").json()
    assert conditions["fit"] is status["fit"] is False
