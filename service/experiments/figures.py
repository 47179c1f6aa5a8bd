"""Line figures, each as a small SVG for documents and as plotly HTML to look into."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import plotly.graph_objects as go

COLOURS = ("#a3201d", "#1f5f99", "#0b6b4f")
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 720, 380, 70, 20, 40, 50
TICKS = 6


@dataclass(frozen=True)
class Curve:
    """One curve; those of a ``group`` share a colour, and one of them stands in the legend by its name."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    group: int
    labelled: bool = True


def draw(path: Path, title: str, x_name: str, y_name: str, curves: Sequence[Curve]) -> None:
    """Write ``path``.svg and ``path``.html; the SVG is the same byte for byte for the same curves."""
    path.with_suffix(".svg").write_text(svg(title, x_name, y_name, curves), encoding="utf-8")
    figure = go.Figure(
        [
            go.Scatter(x=curve.x, y=curve.y, name=curve.name, line={"color": COLOURS[curve.group]}, mode="lines")
            for curve in curves
        ]
    )
    figure.update_layout(title=title, xaxis_title=x_name, yaxis_title=y_name, template="plotly_white")
    figure.write_html(path.with_suffix(".html"), include_plotlyjs="directory", div_id=path.name)


def svg(title: str, x_name: str, y_name: str, curves: Sequence[Curve]) -> str:
    """Return the figure as SVG text."""
    x_ticks = _ticks(min(min(curve.x) for curve in curves), max(max(curve.x) for curve in curves))
    y_ticks = _ticks(min(0.0, *(min(curve.y) for curve in curves)), max(0.0, *(max(curve.y) for curve in curves)))

    def across(value: float) -> float:
        return LEFT + (value - x_ticks[0]) / (x_ticks[-1] - x_ticks[0]) * (WIDTH - LEFT - RIGHT)

    def down(value: float) -> float:
        return HEIGHT - BOTTOM - (value - y_ticks[0]) / (y_ticks[-1] - y_ticks[0]) * (HEIGHT - TOP - BOTTOM)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="12"><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
        f'<text x="{LEFT}" y="22" font-size="15">{escape(title)}</text>',
    ]
    for tick in x_ticks:
        parts.append(f'<text x="{across(tick):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{tick:g}</text>')
    for tick in y_ticks:
        y = down(tick)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#d9e0e6"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    parts.append(f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - 12}" text-anchor="end">{escape(x_name)}</text>')
    parts.append(f'<text x="8" y="{TOP - 4}">{escape(y_name)}</text>')
    for curve in curves:
        points = " ".join(f"{across(x):.1f},{down(y):.1f}" for x, y in zip(curve.x, curve.y, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{COLOURS[curve.group]}" stroke-width="1.6"/>')
    for row, curve in enumerate([curve for curve in curves if curve.labelled]):
        y = TOP + 14 + 18 * row
        parts.append(f'<line x1="{LEFT + 12}" x2="{LEFT + 36}" y1="{y}" y2="{y}" stroke="{COLOURS[curve.group]}"/>')
        parts.append(f'<text x="{LEFT + 42}" y="{y + 4}">{escape(curve.name)}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers from below ``low`` to above ``high``."""
    span = max(high - low, 1e-12)
    rough = span / TICKS
    size = 10.0 ** math.floor(math.log10(rough))
    step = next(size * factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if size * factor >= rough)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [number * step for number in range(first, last + 1)]
