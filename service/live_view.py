"""What a terminal shows of a run while it goes on: its path and how far it is; elsewhere a line for each change."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from service.states import PATH

MARKS = {"done": ("✓", "green"), "now": ("▶", "bold cyan"), "next": ("·", "dim")}


class LiveView:
    """A picture kept up to date on a terminal; where there is none, lines."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console()
        self._live = Live(console=self.console, refresh_per_second=8, transient=True)
        self._last = ""

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def update(self, picture: RenderableType, mark: str, line: str) -> None:
        """Show the picture, or the line where ``mark`` is not what it was."""
        if self.console.is_terminal:
            self._live.update(picture)
        elif mark != self._last:
            self.console.print(line, markup=False, highlight=False)
        self._last = mark


def path_picture(status: dict[str, Any]) -> Group:
    """Return the run's path with the step in hand and how far it is."""
    stage = status["stage"] or status["state"]
    names = [name.value for name in PATH]
    at = names.index(stage) if stage in names else -1
    path = Text()
    for index, name in enumerate(names):
        mark, style = MARKS["done" if index < at or name == "READY" == stage else "now" if index == at else "next"]
        path.append(f"{mark} {name}  ", style=style)
    held = f"  held: {status['reason']}" if status["state"] == "HOLD" else ""
    remaining = "" if status["remaining_s"] is None else f"{status['remaining_s']:.0f} s left"
    line = Table.grid(padding=(0, 2))
    line.add_row(
        Text(f"{status['state']}{held}", style="bold"),
        ProgressBar(total=1.0, completed=status["progress"] or 0.0, width=40),
        remaining,
        Text(f"line {status['link']}", style="dim"),
    )
    return Group(path, line)
