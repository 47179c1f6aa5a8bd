"""What a console shows in a terminal: verdict, path and reasons, old data never looking good."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from service.console.client import SILENT_S
from service.demo_view import picture

LIVE_LINK = "STREAMING"


def verdict(status: dict[str, Any], silent_s: float) -> tuple[str, str]:
    """Return the word and its style."""
    if silent_s > SILENT_S:
        return f"⚠ STALE: the service is silent for {silent_s:.0f} s", "bold yellow"
    if status["link"] != LIVE_LINK and status["age_s"] is not None:
        return f"⚠ STALE: the line is {status['link']}", "bold yellow"
    return ("✓ FIT", "bold green") if status["fit"] else ("✕ NOT FIT", "bold red")


class ConsoleView:
    """Shows statuses live on a terminal, and each change as a line elsewhere."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console()
        self._live = Live(console=self._console, refresh_per_second=8, transient=True)
        self._last: tuple[str, str] = ("", "")

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show(self, status: dict[str, Any], silent_s: float) -> None:
        """Show one status, and how long ago the service last answered."""
        word, style = verdict(status, silent_s)
        if self._console.is_terminal:
            reasons = Text("\n".join(status["reasons"]))
            self._live.update(Group(Panel(Text(word, style=style, justify="center")), picture(status), reasons))
            return
        now = (status["state"], word.split(":")[0])
        if now != self._last:
            self._console.print(f"{now[1]} · {now[0]}: {status['reason']}", markup=False, highlight=False)
        self._last = now

    def conclude(self, status: dict[str, Any]) -> None:
        """Print how it ended."""
        word, style = verdict(status, 0.0)
        self._console.print(Text(f"{word} · {status['state']}", style=style))
        for reason in status["reasons"]:
            self._console.print(f"  {reason}", markup=False, highlight=False)
