"""How it is installed: units, settings, container and wheel, judged by the tools that will read them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
import tomllib
import venv
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from service.config import Settings, load_settings
from service.processes import free_port
from service.store import revisions

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
EXPOSURE_MAX = 2.0


def uncommented(mark: str) -> str:
    """Return ``deploy/inertrim.toml`` with the lines of one mark in force, and of the others only the sections."""
    lines = []
    for line in (DEPLOY / "inertrim.toml").read_text().splitlines():
        active = re.match(rf"{re.escape(mark)} (\w+ = .*|\[\w+\])$", line)
        section = re.fullmatch(r"(## )?(\[\w+\])", line)
        if active:
            lines.append(active[1])
        elif section and (mark == "##" or section[1] is None):
            lines.append(section[2])
    return "\n".join(lines)


def test_the_settings_file_shows_the_defaults(tmp_path: Path) -> None:
    shown = tomllib.loads(uncommented("#"))
    (tmp_path / "inertrim.toml").write_text(uncommented("#"))
    loaded, default = load_settings(tmp_path / "inertrim.toml"), Settings()
    relative = loaded.model_copy(update={"store": loaded.store.model_copy(update={"path": default.store.path})})
    assert relative.model_dump() == default.model_dump()
    assert loaded.store.path == tmp_path / default.store.path
    assert sum(len(section) for section in shown.values()) > 30
    assert load_settings(DEPLOY / "inertrim.toml").link.url is None  # as it comes: OFFLINE on loopback


def test_the_settings_file_has_every_setting_and_its_examples_are_taken(tmp_path: Path) -> None:
    shown, examples = tomllib.loads(uncommented("#")), tomllib.loads(uncommented("##"))
    for section, field in Settings.model_fields.items():
        annotation = field.annotation
        kinds = (annotation, *getattr(annotation, "__args__", ()))
        model: Any = next(kind for kind in kinds if hasattr(kind, "model_fields"))
        known = set(shown.get(section, {})) | set(examples.get(section, {}))
        assert known == set(model.model_fields), f"deploy/inertrim.toml [{section}]"
    (tmp_path / "inertrim.toml").write_text(uncommented("##"))
    assert load_settings(tmp_path / "inertrim.toml").link.url == examples["link"]["url"]


# ---------------------------------------------------------------- systemd


@pytest.fixture
def analyze() -> str:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("systemd-analyze is not installed (Debian: apt install systemd)")
    return tool


@pytest.mark.parametrize("unit", ["inertrim.service", "inertrim-backup.service"])
def test_units_expose_little(analyze: str, unit: str) -> None:
    command = [analyze, "security", "--offline=true", "--no-pager", str(DEPLOY / "systemd" / unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "offline" in done.stderr:
        pytest.skip(f"this systemd-analyze judges no files: {done.stderr.strip()}")
    level = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert level is not None, done.stderr
    assert float(level[1]) <= EXPOSURE_MAX, done.stdout


def test_units_hold_nothing_that_systemd_does_not_know(analyze: str, tmp_path: Path) -> None:
    units = []
    for unit in sorted((DEPLOY / "systemd").glob("inertrim*.[st]*e*")):
        if unit.suffix in (".service", ".timer"):
            text = unit.read_text().replace("/opt/inertrim/bin/inertrim", sys.executable)  # nothing is installed there
            (tmp_path / unit.name).write_text(text)
            units.append(str(tmp_path / unit.name))
    done = subprocess.run([analyze, "verify", "--man=no", *units], capture_output=True, text=True, check=False)
    assert len(units) == 3
    assert str(tmp_path) not in done.stderr, done.stderr
    assert not re.search(r"inertrim.*(nknown|ignoring|ailed|not executable)", done.stderr), done.stderr


def test_the_unit_watches_what_the_service_tells() -> None:
    unit = (DEPLOY / "systemd" / "inertrim.service").read_text()
    assert re.search(r"^Type=notify$", unit, re.MULTILINE)
    assert re.search(r"^WatchdogSec=\d+s$", unit, re.MULTILINE)
    assert re.search(r"^Restart=always$", unit, re.MULTILINE)
    assert re.search(r"^RestartPreventExitStatus=2$", unit, re.MULTILINE)


def test_the_udev_rule_names_a_block_by_its_serial_number() -> None:
    rules = (DEPLOY / "udev" / "70-inertrim.rules").read_text()
    key = r'[A-Z]+(\{[\w/]+\})?(==|!=|\+=|=)"[^"]*"'
    statements = [line for line in rules.splitlines() if line and not line.startswith("#")]
    for line in statements:
        assert re.fullmatch(rf"{key}(, {key})*", line), line
    assert any('SYMLINK+="inertrim/$env{ID_SERIAL_SHORT}"' in line for line in statements)
    assert "u inertrim " in (DEPLOY / "systemd" / "inertrim.sysusers").read_text()  # whom GROUP="inertrim" names


# ---------------------------------------------------------------- container and wheel


def compose() -> dict[str, Any]:
    services: dict[str, Any] = yaml.safe_load((DEPLOY / "container" / "compose.yaml").read_text())["services"]
    return services


def health_check() -> list[str]:
    """Return the command by which the container is judged."""
    text = (DEPLOY / "container" / "Containerfile").read_text().replace("\\\n", " ")
    found = re.search(r"^HEALTHCHECK .*?CMD (\[.*\])$", text, re.MULTILINE)
    assert found is not None
    command: list[str] = json.loads(found[1])
    return command


def test_the_container_is_built_of_what_is_there_and_runs_without_rights() -> None:
    text = (DEPLOY / "container" / "Containerfile").read_text()
    copied = [word for line in re.findall(r"^COPY (?!--from)(.*) \S+$", text, re.MULTILINE) for word in line.split()]
    assert {"pyproject.toml", "requirements-service.lock", "service"} <= set(copied)
    assert all((ROOT / name).exists() for name in copied)
    user = re.findall(r"^USER (\d+)", text, re.MULTILINE)
    assert user
    assert int(user[-1]) > 0
    for service in compose().values():
        assert service["cap_drop"] == ["ALL"]
        assert service["read_only"] is True
        assert "privileged" not in service


def pins(name: str) -> dict[str, set[str]]:
    """Return each package of a lock file with its version and hashes."""
    lines = (ROOT / name).read_text().replace("\\\n", " ").splitlines()
    return {
        line.split("==")[0]: {word for word in line.split() if word.startswith((line.split("==")[0], "--hash"))}
        for line in lines
    }


def test_what_a_launcher_installs_is_what_was_tested_and_no_tool_for_tests() -> None:
    service, tested = pins("requirements-service.lock"), pins("requirements.lock")
    assert {name: tested[name] for name in service} == service
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]

    def names(wanted: list[str]) -> set[str]:
        return {re.split(r"[\[>=<]", one)[0] for one in wanted}

    assert names([*project["dependencies"], *extras["mcap"], *extras["postgres"], *extras["cluster"]]) <= set(service)
    assert not names([*extras["test"], *extras["lint"]]) & set(service)


def test_the_health_check_outlives_an_image_format_that_knows_none() -> None:
    """podman builds in a format without health checks unless told otherwise, and only warns."""
    text = (DEPLOY / "container" / "Containerfile").read_text().replace("\\\n", " ")
    assert compose()["service"]["healthcheck"]["test"] == ["CMD", *health_check()]
    for name, option in (("interval", "interval"), ("timeout", "timeout"), ("start_period", "start-period")):
        assert f"--{option}={compose()['service']['healthcheck'][name]}" in text
    for page in ("docs/install.md", "deploy/container/Containerfile"):
        commands = re.findall(r"podman build .*", (ROOT / page).read_text())
        assert commands
        assert all("--format docker" in command for command in commands), page


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel in an environment of its own; what it depends on is lent, nothing else is there."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for room in ("drivers", "inertial", "simulators", "service"):
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copyfile(ROOT / name, source / name)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "--no-input"]
    build = ["wheel", "--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source]
    subprocess.run([*pip, *map(str, build)], check=True, capture_output=True)
    (wheel,) = folder.glob("inertrim-*.whl")
    shutil.rmtree(source)
    venv.create(folder / "venv")
    install = ["--python", folder / "venv", "install", "--no-index", "--no-deps", "--no-compile", wheel]
    subprocess.run([*pip, *map(str, install)], check=True, capture_output=True)
    return folder / "venv"


def environment() -> dict[str, str]:
    """Return what lends the dependencies: a path, on which the checkout's own editable link does not count."""
    lent = {"PYTHONPATH": sysconfig.get_path("purelib"), "NUMBA_DISABLE_JIT": "1"}  # to compile anew takes a minute
    return {key: value for key, value in os.environ.items() if not key.startswith("INERTRIM_")} | lent


MAKE_STORE = """
from pathlib import Path
import service.api.app, service.store
store = service.store.Store(Path("inertrim.db"))
store.create_run({}, "optimal", None)
print(service.__file__)
"""


def test_commands_work_from_the_wheel_alone(installed: Path, tmp_path: Path) -> None:
    """Migrations run, the API is made, commands answer, and all of it from the wheel and not from this checkout."""

    def run(*command: str) -> str:
        words = [str(installed / "bin" / command[0]), *command[1:]]
        done = subprocess.run(words, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("inertrim", "--version").startswith("inertrim ")
    assert Path(run("python", "-c", MAKE_STORE).strip()).is_relative_to(installed)
    assert run("inertrim", "store", "revision").split()[0] == revisions.known()[-1]
    assert "files" in run("inertrim", "backup", "--out", "a.backup")


@pytest.mark.long
def test_service_and_simulator_run_from_the_wheel_as_the_compose_file_says(installed: Path, tmp_path: Path) -> None:
    """The commands of the compose file, from the wheel: a simulated block on one port, the service on another."""
    line, port = free_port(), free_port()
    changes = {"5760": str(line), "127.0.0.1:5760": f"127.0.0.1:{line}"}

    def command(name: str) -> list[str]:
        words = [changes.get(word, word.replace(":5760", f":{line}")) for word in compose()[name]["command"]]
        return [str(installed / "bin" / "inertrim"), *words]

    variables = environment() | compose()["service"]["environment"]
    with (tmp_path / "log").open("wb") as log:
        simulator = subprocess.Popen(command("simulator"), cwd=tmp_path, env=variables, stdout=log, stderr=log)
        service = subprocess.Popen(
            [*command("service"), "--port", str(port)], cwd=tmp_path, env=variables, stdout=log, stderr=log
        )
        try:
            judge(service, port, (tmp_path / "log"))
            drive(port)
            kept = [str(installed / "bin" / "inertrim"), "backup", "--out", "a.backup"]
            subprocess.run(kept, cwd=tmp_path, env=environment(), check=True, capture_output=True)
        finally:
            for process in (service, simulator):
                process.terminate()
            codes = [process.wait(30) for process in (service, simulator)]
    assert codes[0] == 0, (tmp_path / "log").read_text()[-2000:]


def judge(service: subprocess.Popen[bytes], port: int, log: Path) -> None:
    """Wait until the container's own health check is content."""
    check = [sys.executable if word == "python" else word.replace(":8780", f":{port}") for word in health_check()]
    end_s = time.monotonic() + 200.0
    while subprocess.run(check, capture_output=True, check=False).returncode != 0:
        assert service.poll() is None, log.read_text()[-2000:]
        assert time.monotonic() < end_s, log.read_text()[-2000:]
        time.sleep(0.2)


def drive(port: int) -> None:
    """Ask for what lies in the wheel's data: migrations (a run in the store), metrics, pages."""
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30.0) as client:
        run_id = client.post("/api/v1/runs", json={}).json()["run_id"]
        end_s = time.monotonic() + 60.0
        while client.get("/api/v1/status").json()["state"] in ("OFFLINE", "POWER_UP", "SELF_TEST"):
            assert time.monotonic() < end_s, client.get("/api/v1/status").text
            time.sleep(0.1)
        assert client.get(f"/api/v1/runs/{run_id}").status_code == 200
        assert "inertrim_fit 0.0" in client.get("/metrics").text


@pytest.mark.parametrize("room", ["drivers", "inertial", "simulators", "service"])
def test_the_wheel_has_every_file_of_the_rooms(installed: Path, room: str) -> None:
    (packages,) = installed.glob("lib/python*/site-packages")
    wanted = subprocess.run(["git", "ls-files", room], cwd=ROOT, capture_output=True, text=True, check=False)
    if wanted.returncode != 0:
        pytest.skip("the checkout has no git")
    missing = [name for name in wanted.stdout.split() if not (packages / name).is_file()]
    assert missing == []
