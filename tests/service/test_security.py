"""Tokens, roles, sessions, limits and the audit chain, from outside (docs/security.md)."""

from __future__ import annotations

import sqlite3
import ssl
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from forked import Program, inertrim
from http_bench import serving, settings_for

from service.controller import Controller
from service.processes import free_port
from service.security.rate import RateLimit
from service.security.roles import Role
from service.security.tokens import make_token
from service.store import Store


def give(controller: Controller, role: Role, **more: Any) -> str:
    text, record = make_token(f"the {role}", role, **more)
    controller.store.add_token(record)
    return text


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[httpx.Client, dict[Role, str], Controller]]:
    """A service that has one token of each role."""
    folder = tmp_path_factory.mktemp("guarded")
    settings = settings_for(folder, link={"url": str(folder / "none")}, site={"latitude_deg": 35.7})
    with serving(settings) as (controller, client):
        tokens = {role: give(controller, role) for role in Role}
        time.sleep(2.1)  # the service may have looked just before
        yield client, tokens, controller


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


# ------------------------------------------------------------------ tokens and roles


def test_without_a_token_only_probes_and_the_page_to_sign_in_answer(guarded: Any) -> None:
    client, _, _ = guarded
    for path in ("status", "runs", "events", "metrics", "openapi.json", "audit", "conditions"):
        refused = client.get(f"/api/v1/{path}")
        assert refused.status_code == 401, path
        assert refused.headers["WWW-Authenticate"] == "Bearer"
        assert refused.headers["content-type"] == "application/problem+json"
    for path in ("/healthz", "/readyz", "/", "/dashboard/app.js"):
        assert client.get(path).status_code in (200, 503), path
    assert client.get("/api/v1/session").json() == {"needed": True, "name": None, "role": None, "csrf": None}


@pytest.mark.parametrize("text", ["x", "inertrim_00000000_x", "inertrim_%00_x", "inertrim__"])
def test_a_wrong_token_is_refused(guarded: Any, text: str) -> None:
    assert guarded[0].get("/api/v1/status", headers=bearer(text)).status_code in (401, 429)


def test_each_role_may_what_it_may(guarded: Any) -> None:
    client, tokens, _ = guarded
    adopt = {"sha256": "0" * 64, "operator": "Ada"}
    expected = {Role.VIEWER: (200, 403, 403), Role.OPERATOR: (200, 409, 403), Role.MAINTAINER: (200, 409, 404)}
    for role, (reads, commands, maintains) in expected.items():
        headers = bearer(tokens[role])
        assert client.get("/api/v1/status", headers=headers).status_code == reads
        abort = client.post(
            "/api/v1/conditions/clock/acknowledge", json={"operator": "a", "reason": "b"}, headers=headers
        )
        assert abort.status_code == commands, role
        assert client.post("/api/v1/models/adopt", json=adopt, headers=headers).status_code == maintains, role


def test_the_audit_names_the_token_beside_the_operator(guarded: Any) -> None:
    client, tokens, controller = guarded
    run = client.post("/api/v1/runs", json={"operator": "Ada"}, headers=bearer(tokens[Role.OPERATOR]))
    assert controller.store.audit_log(1)[0]["who"] == "Ada (the operator)"
    client.post(f"{run.headers['Location']}/abort", headers=bearer(tokens[Role.OPERATOR]))
    assert controller.store.audit_log(1)[0]["who"] == "the operator"


def test_a_checked_token_costs_no_argon2_again(guarded: Any) -> None:
    client, tokens, _ = guarded
    headers = bearer(tokens[Role.VIEWER])
    client.get("/api/v1/status", headers=headers)
    took = []
    for _ in range(50):
        began = time.perf_counter()
        assert client.get("/api/v1/status", headers=headers).status_code == 200
        took.append(time.perf_counter() - began)
    argon2_s = 0.02  # what one check costs at the very least: 64 MiB, three passes
    assert sorted(took)[10] < argon2_s


def test_a_revoked_or_expired_token_ends_within_two_seconds_and_so_does_its_stream(guarded: Any) -> None:
    client, _, controller = guarded
    text = give(controller, Role.VIEWER)
    time.sleep(2.1)
    with client.stream("GET", "/api/v1/events", headers=bearer(text)) as stream:
        lines = stream.iter_lines()
        next(lines)
        controller.store.revoke_token(text.split("_")[1])
        began = time.monotonic()
        for _ in lines:
            controller.hub.publish("progress", {})
            assert time.monotonic() - began < 10
    assert httpx.get(client.base_url.join("/api/v1/status"), headers=bearer(text)).status_code == 401
    late, record = make_token("late", Role.VIEWER, days=-1.0)
    controller.store.add_token(record)
    time.sleep(2.1)
    assert httpx.get(client.base_url.join("/api/v1/status"), headers=bearer(late)).status_code == 401


def test_the_store_keeps_no_secret(guarded: Any) -> None:
    _, tokens, controller = guarded
    controller.store.check()
    held = b"".join(path.read_bytes() for path in controller.settings.store.path.parent.glob("inertrim.db*"))
    for text in tokens.values():
        assert text.split("_", 2)[2].encode() not in held
    assert b"$argon2id$" in held


# ------------------------------------------------------------------ sessions


def test_a_session_needs_the_cookie_and_for_commands_the_word_that_other_sites_do_not_know(guarded: Any) -> None:
    client, tokens, _ = guarded
    with httpx.Client(base_url=client.base_url) as browser:
        assert browser.post("/api/v1/session", json={"token": "inertrim_0_0"}).status_code == 401
        answer = browser.post("/api/v1/session", json={"token": tokens[Role.OPERATOR]})
        cookie = answer.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        csrf = answer.json()["csrf"]
        assert browser.get("/api/v1/session").json()["csrf"] == csrf
        assert browser.get("/api/v1/status").status_code == 200
        lease = {"holder": "Ada", "lasts_s": 5}
        refused = browser.post("/api/v1/lease", json=lease)
        assert (refused.status_code, refused.json()["type"]) == (403, "urn:inertrim:problem:csrf")
        assert browser.post("/api/v1/lease", json=lease, headers={"X-CSRF-Token": "guess"}).status_code == 403
        taken = browser.post("/api/v1/lease", json=lease, headers={"X-CSRF-Token": csrf})
        assert taken.status_code == 201
        release = {"X-CSRF-Token": csrf, "Lease-Id": taken.json()["lease_id"]}
        assert browser.delete("/api/v1/lease", headers=release).status_code == 204
        assert browser.delete("/api/v1/session").status_code == 204
        assert browser.get("/api/v1/status").status_code == 401


# ------------------------------------------------------------------ other sites, limits, headers


@pytest.fixture(scope="module")
def open_house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A service without tokens, on loopback, that one may ask little."""
    folder = tmp_path_factory.mktemp("open")
    http = {"requests_per_s": 200.0, "commands_per_s": 2.0, "event_clients": 2}
    with serving(settings_for(folder, http=http)) as (_, client):
        yield client


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://example.org"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "evil.example.org"},
    ],
)
def test_a_page_of_another_site_cannot_command_a_service_that_needs_no_token(
    open_house: httpx.Client, headers: dict[str, str]
) -> None:
    refused = open_house.post("/api/v1/lease", json={"holder": "evil"}, headers=headers)
    assert (refused.status_code, refused.json()["type"]) == (403, "urn:inertrim:problem:cross-site")


def test_a_name_that_is_not_ours_is_not_answered(open_house: httpx.Client) -> None:
    assert open_house.get("/api/v1/status", headers={"Host": "rebound.example.org"}).status_code == 403
    assert open_house.get("/api/v1/status", headers={"Host": "localhost:1234"}).status_code == 200


def test_every_answer_carries_the_headers(open_house: httpx.Client) -> None:
    for path in ("/", "/api/v1/status", "/nothing"):
        headers = open_house.get(path).headers
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        assert policy["script-src"] == "'self'"
        assert policy["default-src"] == "'none'"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
    assert (
        "script" not in open_house.get("/api/v1/runs/x/report").headers["content-security-policy"].split("sandbox")[0]
    )


def test_too_many_commands_are_put_off_and_too_many_streams_refused(open_house: httpx.Client) -> None:
    statuses = [open_house.post("/api/v1/lease", json={"holder": "x", "lasts_s": 5}) for _ in range(30)]
    late = next(answer for answer in statuses if answer.status_code == 429)
    assert int(late.headers["Retry-After"]) >= 1
    assert open_house.get("/api/v1/status").status_code == 200
    address = open_house.base_url.join("/api/v1/events")
    with httpx.stream("GET", address) as first, httpx.stream("GET", address) as second:
        streams = [first.iter_lines(), second.iter_lines()]
        assert [next(stream) for stream in streams] == ["event: status"] * 2
        end = time.monotonic() + 10
        while (refused := open_house.get("/api/v1/events?limit=1")).status_code != 503:
            assert time.monotonic() < end, refused.text


def test_a_bucket_fills_at_its_rate() -> None:
    now = [0.0]
    limit = RateLimit(2.0, clock=lambda: now[0])
    assert [limit.take("a") for _ in range(10)] == [0.0] * 10
    assert limit.take("a") == pytest.approx(0.5)
    assert limit.take("b") == 0.0
    now[0] = 0.5
    assert limit.take("a") == 0.0
    assert limit.take("a") > 0


@pytest.mark.parametrize("path", ["../service/main.py", "..%2fapp.js", "%2e%2e/app.js", "/etc/passwd", "app.js%00.css"])
def test_the_dashboard_gives_its_own_files_alone(open_house: httpx.Client, path: str) -> None:
    assert open_house.get(f"/dashboard/{path}").status_code == 404


def test_plotly_comes_from_the_installed_wheel_packed(open_house: httpx.Client) -> None:
    answer = open_house.get("/dashboard/plotly.min.js")
    assert answer.headers["content-encoding"] == "gzip"
    assert b"Plotly" in answer.content
    again = open_house.get("/dashboard/plotly.min.js", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304


# ------------------------------------------------------------------ command line and start


def test_tokens_are_made_listed_rotated_and_revoked_from_the_command_line(tmp_path: Path) -> None:
    made = inertrim("token", "create", "launch console", "--role", "operator", folder=tmp_path)
    assert made.returncode == 0, made.stderr
    text = made.stdout.strip()
    token_id = text.split("_")[1]
    assert text.startswith("inertrim_")
    listed = inertrim("token", "list", folder=tmp_path).stdout
    assert all(part in listed for part in (token_id, "operator", "launch console", "until revoked"))
    assert text.split("_", 2)[2] not in listed
    rotated = inertrim("token", "rotate", token_id, "--days", "30", folder=tmp_path).stdout.strip()
    again = inertrim("token", "revoke", token_id, folder=tmp_path)
    assert (again.returncode, "no valid token" in again.stderr) == (2, True)
    assert inertrim("token", "revoke", rotated.split("_")[1], folder=tmp_path).returncode == 0
    commands = [one["command"] for one in Store(tmp_path / "inertrim.db").audit_log()]
    assert commands == ["token revoke", "token rotate", "token create"]


def test_an_address_that_others_reach_is_refused_without_tokens(tmp_path: Path) -> None:
    refused = inertrim("serve", "--host", "0.0.0.0", "--port", "0", folder=tmp_path)
    assert refused.returncode == 2
    assert "inertrim token create" in refused.stderr
    half = tmp_path / "half.toml"
    half.write_text('[http]\ncertificate = "none.pem"\n')
    refused = inertrim("serve", "--config", str(half), folder=tmp_path)
    assert refused.returncode == 2
    assert "belong together" in refused.stderr


def test_with_a_token_and_a_certificate_it_listens_for_other_machines(tmp_path: Path) -> None:
    token = inertrim("token", "create", "console", "--role", "viewer", folder=tmp_path).stdout.strip()
    certificate, key = self_signed(tmp_path)
    port = free_port()
    (tmp_path / "inertrim.toml").write_text(
        f'[http]\nhost = "0.0.0.0"\nport = {port}\ncertificate = "{certificate.name}"\nkey = "{key.name}"\n'
    )
    with (tmp_path / "log").open("wb") as log:
        service = Program("serve", "--config", "inertrim.toml", folder=tmp_path, stdout=log, stderr=log)
    try:
        trusted = ssl.create_default_context(cafile=certificate)
        with httpx.Client(base_url=f"https://localhost:{port}", verify=trusted) as client:
            end = time.monotonic() + 60
            while True:
                try:
                    alive = client.get("/healthz")
                    break
                except httpx.TransportError:
                    assert service.poll() is None, (tmp_path / "log").read_text()
                    assert time.monotonic() < end
                    time.sleep(0.05)
            assert alive.status_code == 200
            assert "max-age" in alive.headers["strict-transport-security"]
            assert client.get("/api/v1/status").status_code == 401
            assert client.get("/api/v1/status", headers=bearer(token)).json()["state"] == "OFFLINE"
            assert "secure" in client.post("/api/v1/session", json={"token": token}).headers["set-cookie"].lower()
        with pytest.raises(httpx.TransportError):
            httpx.get(f"http://localhost:{port}/healthz")
    finally:
        service.terminate()
        service.wait(20)


def self_signed(folder: Path) -> tuple[Path, Path]:
    """Write a certificate for localhost and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    certificate, secret = folder / "certificate.pem", folder / "key.pem"
    certificate.write_bytes(made.public_bytes(Encoding.PEM))
    secret.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return certificate, secret


# ------------------------------------------------------------------ the audit chain


@pytest.fixture
def audited(tmp_path: Path) -> Path:
    """A store with twenty entries; its triggers taken off, as whoever edits a file would."""
    store = Store(tmp_path / "inertrim.db")
    for number in range(20):
        store.audit("Ada", "start", None, "accepted", f"entry {number}")
    store.close()
    return tmp_path


def edit(folder: Path, *statements: str) -> None:
    with sqlite3.connect(folder / "inertrim.db") as connection:
        for trigger in ("audit_no_update", "audit_no_delete"):
            connection.execute(f"DROP TRIGGER {trigger}")
        for statement in statements:
            connection.execute(statement)
    connection.close()


def faults_of(folder: Path, noted: dict[int, str] | None = None) -> list[str]:
    store = Store(folder / "inertrim.db")
    found = store.verify_audit(noted or {})
    store.close()
    return list(found.faults)


@pytest.mark.parametrize("statement", ["UPDATE audit SET who = 'Eve' WHERE number = 7", "DELETE FROM audit"])
def test_the_store_refuses_to_change_the_log(audited: Path, statement: str) -> None:
    with (
        sqlite3.connect(audited / "inertrim.db") as connection,
        pytest.raises(sqlite3.DatabaseError, match="append-only"),
    ):
        connection.execute(statement)


@pytest.mark.parametrize(
    ("statement", "named"),
    [
        ("UPDATE audit SET who = 'Eve' WHERE number = 7", "entry 7 "),
        ("UPDATE audit SET detail = '' WHERE number = 20", "entry 20 "),
        ("UPDATE audit SET utc = '2020-01-01T00:00:00Z' WHERE number = 1", "entry 1 "),
        ("DELETE FROM audit WHERE number = 7", "entry 7 is missing"),
        ("DELETE FROM audit WHERE number = 1", "entry 1 is missing"),
        ("DELETE FROM audit WHERE number > 15", "entry 20 was the last"),
        ("DELETE FROM audit", "entry 20 was the last"),
        ("UPDATE audit SET number = 21 - number WHERE number IN (10, 11)", "entry 1"),
    ],
)
def test_every_edit_is_found(audited: Path, statement: str, named: str) -> None:
    assert faults_of(audited) == []
    edit(audited, statement)
    assert any(named in fault for fault in faults_of(audited))


def test_a_tail_cut_off_with_its_head_is_found_by_the_file_beside_the_store_or_by_what_was_noted(audited: Path) -> None:
    noted = Store(audited / "inertrim.db").audit_log(1)[0]
    witness = {noted["number"]: noted["sha256"]}
    assert faults_of(audited, witness) == []
    edit(
        audited,
        "DELETE FROM audit WHERE number > 15",
        "UPDATE audit_heads SET entries = 15, sha256 = (SELECT sha256 FROM audit WHERE number = 15)",
    )
    assert any("entry 16 is gone" in fault for fault in faults_of(audited))
    (audited / "inertrim.db.audit").unlink()
    assert faults_of(audited) == []  # nothing is left that knows of it …
    assert any("entry 20 is gone" in fault for fault in faults_of(audited, witness))  # … but what was noted


def test_the_command_line_tells_by_its_exit_code_and_prints_the_head_to_note(audited: Path) -> None:
    sound = inertrim("audit", "verify", folder=audited)
    head = Store(audited / "inertrim.db").audit_log(1)[0]["sha256"]
    assert (sound.returncode, f"20:{head}" in sound.stdout) == (0, True), sound.stderr
    noted = inertrim("audit", "verify", "--noted", f"20:{'0' * 64}", "--json", "-", folder=audited)
    assert (noted.returncode, "entry 20 differs" in noted.stdout) == (1, True)
    assert inertrim("audit", "verify", "--noted", "twenty", folder=audited).returncode == 2
