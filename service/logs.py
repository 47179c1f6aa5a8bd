"""Log lines to standard error, one fact a field: JSON or text for a console, marked with the run in hand."""

from __future__ import annotations

import logging
import sys
from typing import Any, TextIO

import structlog

from service.config import LogSettings

_in_hand: dict[str, str] = {}


def configure_logs(settings: LogSettings, stream: TextIO | None = None) -> None:
    """Send every line of this process, those of libraries included, to ``stream`` (standard error)."""
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        _mark_run,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Any] = [structlog.stdlib.ProcessorFormatter.remove_processors_meta]
    if settings.format == "json":
        last += [structlog.processors.dict_tracebacks, structlog.processors.JSONRenderer(default=str)]
    else:
        last += [structlog.dev.ConsoleRenderer(colors=False)]
    handler = _Handler(stream or sys.stderr)
    handler.setFormatter(structlog.stdlib.ProcessorFormatter(processors=last, foreign_pre_chain=shared))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(settings.level.upper())
    logging.captureWarnings(True)  # Python's own warnings too: two bare lines of text are no JSON
    for quiet in ("alembic", "httpx", "uvicorn.access"):
        logging.getLogger(quiet).setLevel(logging.WARNING)
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,
    )


def correlate(run_id: str | None) -> None:
    """Mark every line from now on, from whichever thread, with the run in hand; None: there is none."""
    if run_id is None:
        _in_hand.clear()
    else:
        _in_hand["run_id"] = run_id


def _mark_run(logger: Any, method: str, event: dict[str, Any]) -> dict[str, Any]:
    """Add the run in hand to a line that names none of its own."""
    del logger, method
    return {**_in_hand, **event}


class _Handler(logging.StreamHandler[TextIO]):
    """Writes lines; one that cannot be written (a full disk, a closed terminal) is dropped and hurts nobody."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop the line."""
        del record
