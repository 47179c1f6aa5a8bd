"""The real application on a real socket, in this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import uvicorn

from service.api import create_app
from service.config import Settings, load_settings
from service.controller import Controller


def settings_for(folder: Path, **sections: dict[str, Any]) -> Settings:
    """Return settings with their store in ``folder``."""
    return load_settings(None, **{"store": {"path": folder / "inertrim.db"}, **sections})


@contextmanager
def serving(settings: Settings) -> Iterator[tuple[Controller, httpx.Client]]:
    """Serve a controller and give a client to it."""
    controller = Controller(settings)
    server = uvicorn.Server(
        uvicorn.Config(create_app(controller), port=0, log_level="warning", lifespan="off", timeout_graceful_shutdown=1)
    )
    thread = threading.Thread(target=server.run, daemon=True)
    controller.start()
    thread.start()
    deadline = time.monotonic() + 20
    while not server.started:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as client:
            yield controller, client
    finally:
        server.should_exit = True
        thread.join(10)
        controller.stop()
