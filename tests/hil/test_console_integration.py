"""Consoles before the real service: the documented examples, a generated client, and `inertrim console`."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import Program, inertrim
from line_service import Bench, ServiceProcess

from service.processes import free_port

PAGE = (Path(__file__).parents[2] / "docs" / "console-integration.md").read_text()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    bench = Bench(tmp_path_factory.mktemp("console"))
    made = ServiceProcess(bench, free_port())
    yield made
    made.terminate()
    bench.close()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def surroundings(service: ServiceProcess) -> dict[str, str]:
    return {**os.environ, "INERTRIM": str(service.client.base_url).rstrip("/")}


def test_the_documented_shell_examples_work_in_their_order(service: ServiceProcess) -> None:
    script = "set -euo pipefail\n" + "\n".join(blocks("sh"))
    ran = subprocess.run(
        ["bash", "-c", script], env=surroundings(service), capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.returncode == 0, ran.stderr
    codes = re.findall(r"^\d{3}$", ran.stdout.replace("}", "}\n"), re.MULTILINE)
    assert codes[-1] == "423"
    assert codes[0] in ("304", "200")  # the status is made anew twenty times a second
    run = service.get("/runs")["runs"][0]
    assert (run["operator"], run["state"], run["reason"]) == ("Ada", "ABORTED", "operator")
    assert service.get("/lease")["holder"] is None


def test_the_documented_program_follows_a_whole_run(service: ServiceProcess) -> None:
    (program,) = blocks("python")
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env=surroundings(service),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    lines = ran.stdout.splitlines()
    assert lines[0] == "POWER_UP start"
    assert "READY verified" in lines
    assert lines[-2].startswith("fit ")
    assert lines[-1].startswith("shift compensated ")


def test_a_generated_client_drives_a_whole_run(service: ServiceProcess, tmp_path: Path) -> None:
    document = tmp_path / "openapi.json"
    document.write_bytes(service.client.get("/openapi.json").content)
    (settings,) = blocks("yaml")
    (tmp_path / "generator.yml").write_text(settings + "post_hooks: []\n")
    command = ["openapi-python-client", "generate", "--path", str(document), "--meta", "none", "--output-path"]
    command += [str(tmp_path / "made"), "--config", str(tmp_path / "generator.yml")]
    program = Path(sys.executable).parent / command[0]
    ran = subprocess.run([str(program), *command[1:]], capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    assert "WARNING" not in ran.stdout, ran.stdout
    assert "Unable" not in ran.stdout, ran.stdout
    sys.path.insert(0, str(tmp_path))
    try:
        made = importlib.import_module("made")
        models = importlib.import_module("made.models")
        start = importlib.import_module("made.api.runs.start_run_api_v1_runs_post")
        status = importlib.import_module("made.api.status.read_status_api_v1_status_get")
        result = importlib.import_module("made.api.runs.read_result_api_v1_runs_run_id_result_get")
        listing = importlib.import_module("made.api.runs.list_runs_api_v1_runs_get")
    finally:
        sys.path.remove(str(tmp_path))
    client = made.Client(base_url=str(service.client.base_url).removesuffix("/api/v1/").removesuffix("/api/v1"))
    accepted = start.sync(client=client, body=models.RunStart(operator="Grace"))
    end = time.monotonic() + 90
    while (now := status.sync(client=client)).state != "READY":
        assert now.state not in ("FAULT", "ABORTED"), now
        assert time.monotonic() < end, now
        time.sleep(0.05)
    assert now.run_id == accepted.run_id
    assert now.fit is True
    assert json.loads(result.sync_detailed(accepted.run_id, client=client).content)["verdict"] == "shift compensated"
    newest = listing.sync(client=client).runs[0]
    assert (newest.run_id, newest.operator) == (accepted.run_id, "Grace")


def test_the_console_starts_under_a_lease_and_another_takes_over_to_abort(
    service: ServiceProcess, tmp_path: Path
) -> None:
    url = str(service.client.base_url).split("/api/")[0]
    with (tmp_path / "said").open("wb") as said, (tmp_path / "complained").open("wb") as complained:
        starting = Program("console", "start", "--operator", "Ada", "--url", url, stdout=said, stderr=complained)
    service.until("SETTLING")
    common = ["console", "abort", "--operator", "Grace", "--reason", "drill", "--url", url]
    refused = inertrim(*common)
    assert refused.returncode == 1
    assert "Ada commands this service" in refused.stderr
    taken = inertrim(*common, "--take-over")
    assert taken.returncode == 0, taken.stderr
    assert starting.wait(30) == 1, (tmp_path / "complained").read_text()
    assert "ABORTED" in (tmp_path / "said").read_text()
    assert service.get("/lease")["holder"] is None
    assert "Grace" in service.get("/audit")["entries"][1]["who"]
