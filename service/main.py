"""``inertrim serve``: the controller and its HTTP server in one process, ended cleanly by SIGTERM or Ctrl-C."""

from __future__ import annotations

import logging
import signal
import socket
import sys

import structlog
import uvicorn

from service.api import create_app
from service.config import ConfigError, HttpSettings, Settings
from service.controller import Controller
from service.store import StoreError

log = structlog.get_logger()

SHUTDOWN_S = 2
"""Real seconds that open event streams get before they are cut."""


def run_service(settings: Settings) -> None:
    """Serve until told to end; a run in hand is then ABORTED with reason ``service_stopped``.

    Raises
    ------
    ConfigError, LinkError, ProtocolError
        What is configured cannot be used.
    """
    _log_to_stderr()
    check_files(settings)
    listening = _listen(settings.http)
    try:
        controller = Controller(settings)
    except StoreError as error:
        raise ConfigError(str(error)) from None
    server = uvicorn.Server(
        uvicorn.Config(
            create_app(controller),
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=SHUTDOWN_S,
            lifespan="off",
        )
    )
    for number in (signal.SIGTERM, signal.SIGINT):
        # uvicorn ends by its own handlers and raises the signal once more: that must not end us before we have closed.
        signal.signal(number, _already_ending)
    controller.start()
    try:
        server.run([listening])
    finally:
        controller.stop()


def _listen(http: HttpSettings) -> socket.socket:
    """Return the listening socket, taken before anything else so that a port in use stops nothing half-way."""
    family = socket.AF_INET6 if ":" in http.host else socket.AF_INET
    try:
        listening = socket.create_server((http.host, http.port), family=family)
    except OSError as error:
        remedy = "Stop what listens there, or set another [http] host and port."
        raise ConfigError(f"http://{http.host}:{http.port}: {error.strerror or error}. {remedy}") from None
    host, port = listening.getsockname()[:2]
    log.info("listening", address=f"http://{host}:{port}/api/v1")
    return listening


def _already_ending(number: int, frame: object) -> None:
    """Take a signal that the server has obeyed."""
    del number, frame


def check_files(settings: Settings) -> None:
    """Refuse a calibration or model that a run could not use, before anyone waits for the run."""
    from inertial.documents import BlockModel, Calibration, DocumentError, parse_document

    for path, kind in ((settings.block.calibration, Calibration), (settings.block.model, BlockModel)):
        if path is None:
            continue
        try:
            parse_document(kind, path.read_bytes(), str(path))
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}. Correct the path in section [block].") from None
        except DocumentError as error:
            raise ConfigError(str(error)) from None


def _log_to_stderr() -> None:
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
