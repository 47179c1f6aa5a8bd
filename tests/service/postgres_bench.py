"""A real PostgreSQL server, made for the tests from Debian's packages and ended with them."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import pytest

INSTALLED = Path("/usr/lib/postgresql")
OWNERS = ("postgres", "nobody")
"""Who the server runs as where the tests run as root, which it refuses."""
QUICK = "-c fsync=off -c full_page_writes=off -c listen_addresses= -c shared_buffers=16MB -c max_connections=60"


class Postgres:
    """One server on a Unix socket; every database in it is empty when it is given."""

    def __init__(self, folder: Path, tools: Path, owner: str | None) -> None:
        self._folder, self._tools, self._owner = folder, tools, owner

    def database_url(self) -> str:
        """Return the URL of a new database."""
        name = f"store_{uuid4().hex[:12]}"
        self.run("createdb", "--host", str(self._folder), "--username", "inertrim", "--template", "template0", name)
        return f"postgresql://inertrim@/{name}?host={self._folder}"

    def run(self, tool: str, *arguments: str) -> None:
        """Run one of the server's own programs as its owner."""
        command = [str(self._tools / tool), *arguments]
        done = subprocess.run(
            command, user=self._owner, cwd=self._folder, capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, f"{tool}: {done.stdout}{done.stderr}"


@contextmanager
def postgres_server() -> Iterator[Postgres]:
    """Start a server in a folder of its own; skip, with the reason, where there is none to start."""
    pytest.importorskip("psycopg", reason="the extra [postgres] is not installed")
    tools = max(INSTALLED.glob("*/bin"), key=lambda path: int(path.parent.name), default=None)
    if tools is None or not (tools / "initdb").is_file():
        pytest.skip(f"no PostgreSQL server under {INSTALLED} (Debian: apt install postgresql)")
    owner = None
    if os.geteuid() == 0:
        known = {entry.pw_name for entry in pwd.getpwall()}
        owner = next((name for name in OWNERS if name in known), None)
        if owner is None:
            pytest.skip("PostgreSQL refuses to run as root, and there is neither a user postgres nor nobody")
    folder = Path(tempfile.mkdtemp(prefix="inertrim-pg-", dir="/tmp"))  # a socket's path may have 107 characters
    if owner is not None:
        shutil.chown(folder, owner)
    server = Postgres(folder, tools, owner)
    data = str(folder / "data")
    try:
        server.run(
            "initdb", "--pgdata", data, "--username", "inertrim", "--auth", "trust", "--no-sync", "--locale", "C"
        )
        options = f"{QUICK} -c unix_socket_directories={folder}"
        server.run("pg_ctl", "--pgdata", data, "--log", str(folder / "log"), "--options", options, "--wait", "start")
        try:
            yield server
        finally:
            server.run("pg_ctl", "--pgdata", data, "--mode", "immediate", "--wait", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
