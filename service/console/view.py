"""What a console shows in a terminal: verdict, path and reasons, old data never looking good."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.panel import Panel
from rich.text import Text

from service.console.client import SILENT_S
from service.live_view import LiveView, path_picture

LIVE_LINK = "STREAMING"


def verdict(status: dict[str, Any], silent_s: float) -> tuple[str, str]:
    """Return the word and its style."""
    if silent_s > SILENT_S:
        return f"⚠ STALE: the service is silent for {silent_s:.0f} s", "bold yellow"
    if status["link"] != LIVE_LINK and status["age_s"] is not None:
        return f"⚠ STALE: the line is {status['link']}", "bold yellow"
    return ("✓ FIT", "bold green") if status["fit"] else ("✕ NOT FIT", "bold red")


class ConsoleView(LiveView):
    """Shows each status with its verdict, and how the run ended."""

    def show(self, status: dict[str, Any], silent_s: float) -> None:
        """Show one status, and how long ago the service last answered."""
        word, style = verdict(status, silent_s)
        board = Panel(Text(word, style=style, justify="center"))
        mark = f"{word.split(':')[0]} · {status['state']}"
        self.update(
            Group(board, path_picture(status), Text("\n".join(status["reasons"]))), mark, f"{mark}: {status['reason']}"
        )

    def conclude(self, status: dict[str, Any]) -> None:
        """Print how it ended."""
        word, style = verdict(status, 0.0)
        self.console.print(Text(f"{word} · {status['state']}", style=style))
        for reason in status["reasons"]:
            self.console.print(f"  {reason}", markup=False, highlight=False)
