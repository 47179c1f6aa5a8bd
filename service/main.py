"""``inertrim serve``: the controller and its HTTP server in one process, ended cleanly by SIGTERM or Ctrl-C."""

from __future__ import annotations

import gc
import signal
import socket
import ssl

import structlog
import uvicorn

from service.api import create_app
from service.api.gate import is_loopback
from service.config import ConfigError, HttpSettings, Settings
from service.controller import Controller
from service.logs import configure_logs
from service.native_memory import fill, give_back, trim
from service.security.tokens import Tokens
from service.store import StoreError
from service.watchdog import Notifier

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
    configure_logs(settings.log)
    give_back()
    fill()
    check_files(settings)
    notifier = Notifier()
    listening = _listen(settings.http)
    try:
        controller = Controller(settings, notifier.beat)
    except StoreError as error:
        raise ConfigError(str(error)) from None
    try:
        check_reach(settings.http, controller.tokens)
    except ConfigError:
        listening.close()
        controller.store.close()
        raise
    server = uvicorn.Server(
        uvicorn.Config(
            create_app(controller),
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=SHUTDOWN_S,
            lifespan="off",
            ssl_certfile=settings.http.certificate,
            ssl_keyfile=settings.http.key,
        )
    )

    def end(number: int, frame: object) -> None:
        """Have the server end: while it is not up yet, and once more when it raises the signal that it has obeyed."""
        del number, frame
        server.should_exit = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    controller.start()
    # What start-up made stays for good. A full collection through all of it holds every thread for a tenth of a second,
    # three times as long as a pseudo-terminal holds a 2 kHz block's frames.
    gc.collect()
    gc.freeze()
    trim()
    notifier.ready()
    try:
        server.run([listening])
    finally:
        notifier.stopping()
        controller.stop()


def check_reach(http: HttpSettings, tokens: Tokens) -> None:
    """Refuse an address that other machines reach while anybody could command there."""
    if is_loopback(http.host) or tokens.exist():
        return
    remedy = "Make one (`inertrim token create NAME --role operator`), or set [http] host to 127.0.0.1."
    raise ConfigError(
        f"http://{http.host}:{http.port}: other machines reach this address, and no token exists. {remedy}"
    )


def check_certificate(http: HttpSettings) -> None:
    """Refuse a certificate that cannot be used."""
    if http.certificate is None and http.key is None:
        return
    if http.certificate is None or http.key is None:
        raise ConfigError("settings: [http] certificate and key belong together. Give both, or none.")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(http.certificate, http.key)
    except OSError as error:
        raise ConfigError(
            f"{http.certificate}, {http.key}: not usable for TLS ({error}). Give a PEM certificate and its own key."
        ) from None


def _listen(http: HttpSettings) -> socket.socket:
    """Return the listening socket, taken before anything else so that a port in use stops nothing half-way."""
    family = socket.AF_INET6 if ":" in http.host else socket.AF_INET
    try:
        listening = socket.create_server((http.host, http.port), family=family)
    except OSError as error:
        remedy = "Stop what listens there, or set another [http] host and port."
        raise ConfigError(f"http://{http.host}:{http.port}: {error.strerror or error}. {remedy}") from None
    host, port = listening.getsockname()[:2]
    log.info("listening", address=f"{'http' if http.certificate is None else 'https'}://{host}:{port}/api/v1")
    return listening


def check_files(settings: Settings) -> None:
    """Refuse a calibration or model that a run could not use, before anyone waits for the run."""
    from inertial.documents import BlockModel, Calibration, DocumentError, parse_document

    check_certificate(settings.http)
    for path, kind in ((settings.block.calibration, Calibration), (settings.block.model, BlockModel)):
        if path is None:
            continue
        try:
            parse_document(kind, path.read_bytes(), str(path))
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}. Correct the path in section [block].") from None
        except DocumentError as error:
            raise ConfigError(str(error)) from None
