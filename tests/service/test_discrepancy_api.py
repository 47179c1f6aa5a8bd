"""The discrepancy workflow over HTTP: started on known recordings, followed, read; its model adopted by command."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from http_bench import serving, settings_for
from rest_bench import believed_model, write_rest

from service.controller import Controller
from simulators.model_store import load_model, save_model

SHIFT_MPS2 = 5e-3
PLACE = "/api/v1/discrepancies"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, httpx.Client]]:
    folder = tmp_path_factory.mktemp("discrepancies")
    (folder / "recordings").mkdir()
    for place, name in ((folder / "recordings", "bench"), (folder, "outside")):
        write_rest(place, name, seed=7, accel_z_mps2=SHIFT_MPS2)
    save_model(believed_model(), folder / "block.json")
    settings = settings_for(
        folder, block={"model": folder / "block.json"}, library={"recordings": folder / "recordings"}
    )
    with serving(settings) as served:
        yield served


def followed(client: httpx.Client, location: str) -> list[dict]:
    """Return the events of a job until it is over."""
    told = []
    with client.stream("GET", f"{location}/events", timeout=120) as stream:
        for line in stream.iter_lines():
            if line.startswith("data:"):
                told.append(json.loads(line[5:]))
    return [facts for facts in told if "state" in facts]


def test_it_is_started_followed_read_and_its_model_adopted(service: tuple[Controller, httpx.Client]) -> None:
    controller, client = service
    asked = {"recordings": [{"name": "bench"}], "operator": "Ada"}
    answer = client.post(PLACE, json=asked, headers={"Idempotency-Key": "one"})
    assert answer.status_code == 202, answer.text
    location = answer.headers["Location"]
    again = client.post(PLACE, json=asked, headers={"Idempotency-Key": "one"})
    assert again.json()["id"] == answer.json()["id"]
    other = client.post(PLACE, json={**asked, "operator": "Bob"}, headers={"Idempotency-Key": "one"})
    assert other.status_code == 422
    assert other.json()["type"].endswith("idempotency-key-reused")

    events = followed(client, location)
    shares = [facts["share"] for facts in events]
    assert shares == sorted(shares)
    assert events[-1]["state"] == "done"

    detail = client.get(location).json()
    assert detail["progress"] == 1.0
    assert detail["verdict"] in ("named", "tie")
    assert detail["operator"] == "Ada"
    names = {(f["effect"], f["channel"]) for f in detail["report"]["findings"]}
    names |= {(a["effect"], a["channel"]) for f in detail["report"]["findings"] for a in f["alternatives"]}
    assert ("bias_shift", "accel_z") in names
    page = client.get(f"{location}/report")
    assert page.headers["content-type"].startswith("text/html")
    assert "accel_z" in page.text
    listing = client.get(PLACE).json()
    assert [job["id"] for job in listing["discrepancies"]] == [detail["id"]]
    assert listing["recordings"] == ["bench"]

    before = controller.models.sha256()
    assert detail["model"] == before
    wrong = client.post("/api/v1/models/adopt", json={"sha256": "0" * 64, "operator": "Ada"})
    assert wrong.status_code == 404
    adopted = client.post("/api/v1/models/adopt", json={"sha256": detail["found"], "operator": "Ada", "reason": "fits"})
    assert adopted.status_code == 200, adopted.text
    chosen = controller.models.path()
    assert chosen is not None
    assert load_model(chosen).parent == before
    assert controller.models.sha256() == detail["found"]
    audit = [(e["who"], e["command"], e["outcome"]) for e in controller.store.audit_log()]
    assert audit[:2] == [("Ada", "adopt", "accepted"), ("Ada", "adopt", "refused")]
    assert ("Ada", "discrepancy", "accepted") in audit


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"recordings": [{"name": "../outside"}]}, 404),
        ({"recordings": [{"name": "outside"}]}, 404),
        ({"recordings": [{"run_id": "20260101T000000000000-0000"}]}, 404),
        ({"recordings": [{"name": "bench", "run_id": "x"}]}, 422),
        ({"recordings": []}, 422),
        ({"recordings": [{"name": "bench"}], "model": "f" * 64}, 404),
        ({"recordings": [{"name": "bench"}], "model": "../block"}, 422),
    ],
)
def test_only_what_the_service_knows_is_read(service: tuple[Controller, httpx.Client], body: dict, status: int) -> None:
    _, client = service
    answer = client.post(PLACE, json=body)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_job_that_a_stop_cut_short_is_interrupted_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    write_rest(tmp_path / "recordings", "bench", seed=7)
    settings = settings_for(tmp_path, library={"recordings": tmp_path / "recordings"})
    with serving(settings) as (_, client):
        location = client.post(PLACE, json={"recordings": [{"name": "bench"}]}).headers["Location"]
    deadline = time.monotonic() + 20
    with serving(settings) as (_, client):
        detail = client.get(location).json()
        assert time.monotonic() < deadline
    assert detail["state"] == "interrupted"
    assert detail["report"] is None
    assert detail["ended"] is not None


def test_the_process_of_a_job_ends_with_the_service_that_started_it(tmp_path: Path) -> None:
    write_rest(tmp_path, "bench", seed=7, accel_z_mps2=SHIFT_MPS2)
    save_model(believed_model(), tmp_path / "block.json")
    module = [sys.executable, "-m", "service.discrepancy_worker"]
    places = [str(tmp_path / name) for name in ("block.json", "out", "bench.parquet")]
    job = subprocess.Popen([*module, *places], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert job.stdout is not None
    assert job.stdin is not None
    assert "share" in json.loads(job.stdout.readline())
    job.stdin.close()  # as the kernel does for a service that is killed
    assert job.wait(30) == 1
    assert "verdict" not in job.stdout.read()
    job.stdout.close()
