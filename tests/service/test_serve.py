"""``inertrim serve`` as a process: what it cannot use is refused in one line with exit code 2, before it listens."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from forked import inertrim

from service.store import Store


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ("[site]\nlatitude_rad = 0.6\n", "latitude_rad"),
        ('[block]\ncalibration = "missing.json"\n', "missing.json"),
        ('[block]\ncalibration = "settings.toml"\n', "not JSON"),
        ('[link]\nurl = "x"\nprotocol = "morse"\n', "morse"),
        ('[link]\nurl = "strange://x"\n', "strange"),
        ('[store]\npath = "nowhere/inertrim.db"\n', "nowhere"),
    ],
)
def test_settings_that_cannot_be_used(tmp_path: Path, settings: str, named: str) -> None:
    (tmp_path / "settings.toml").write_text(settings)
    refused = inertrim("serve", "--config", "settings.toml", "--port", "0", folder=tmp_path)
    assert refused.returncode == 2, refused.stderr
    assert named in refused.stderr
    assert "Traceback" not in refused.stderr


def test_a_port_in_use_and_a_store_in_use(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = inertrim("serve", "--port", str(port), folder=tmp_path)
    assert refused.returncode == 2
    assert f"127.0.0.1:{port}" in refused.stderr
    store = Store(tmp_path / "inertrim.db", alone=True)
    refused = inertrim("serve", "--port", "0", folder=tmp_path)
    store.close()
    assert refused.returncode == 2
    assert "another inertrim uses it" in refused.stderr
    assert "Traceback" not in refused.stderr
