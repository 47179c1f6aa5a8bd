"""One run as one self-contained HTML page, made from ``result.json`` alone, the same byte for byte every time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from inertial.documents import CHANNELS, Result
from service.radial import radial_without

MG_MPS2 = 9.80665e-3
DEG_H_RADPS = math.pi / 180 / 3600
SENSORS = ("accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z")
MARKS = {"shift compensated": "✓", "no significant shift": "✓", "not fit": "✕"}
STAGE_NAMES = {"stage_1": "stage 1", "stage_2": "stage 2", "stage_3": "stage 3", "final": "final"}

STYLE = """
:root{--ink:#16202b;--dim:#5a6875;--line:#d9e0e6;--paper:#fff;--good:#0b6b4f;--bad:#a3201d;--blue:#1f5f99}
@media (prefers-color-scheme:dark){:root{--ink:#e8edf2;--dim:#9fb0bf;--line:#32414f;--paper:#121a22;
--good:#5fd3ab;--bad:#ff8f87;--blue:#7fb8ee}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:60rem;padding:2rem 1.2rem 4rem;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",sans-serif}
h1{font-size:1.5rem;margin:0}
h2{font-size:1.05rem;margin:2.2rem 0 .6rem;border-bottom:1px solid var(--line);padding-bottom:.3rem}
p{margin:.4rem 0}
.dim{color:var(--dim)}
.verdict{margin:1.4rem 0;padding:1rem 1.2rem;border:2px solid currentColor;border-radius:.6rem}
.verdict b{font-size:1.5rem}
.good{color:var(--good)}
.bad{color:var(--bad)}
.verdict ul{margin:.5rem 0 0;padding-left:1.2rem;color:var(--ink)}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{padding:.28rem .6rem;text-align:right;border-bottom:1px solid var(--line)}
th{font-weight:600;color:var(--dim)}
th:first-child,td:first-child,td.text,th.text{text-align:left}
code{font:12px/1.4 ui-monospace,Menlo,monospace;overflow-wrap:anywhere}
.wide{overflow-x:auto}
svg{width:100%;height:auto;display:block}
svg text{font:11px system-ui,sans-serif;fill:var(--dim)}
.small td{white-space:nowrap;font-size:.75rem;padding:.25rem .3rem}
.sign td{height:2.6rem;min-width:8rem;vertical-align:bottom}
@media print{body{max-width:none;padding:0}h2{break-after:avoid}table,svg{break-inside:avoid}}
"""


def render(result: Result) -> str:
    """Return the HTML report of one result.

    Parameters
    ----------
    result
        The run's result document; nothing else enters, so the page can be made again years later.
    """
    sections = [
        _head(result),
        _verdict(result),
        _section("Identity", _identity(result)),
        _section("Terms added to the readings", _terms_table(result) + _terms_figure(result)),
        _section("Verification on fresh data", _verification(result)),
        _section("Navigation error to expect at rest", _budget(result) + _navigation_figure(result)),
        _section("What the run could not see", _unobservable(result)),
        _section("Site and reference", _facts({**result.site, **result.reference})),
        _section("Alignment", _facts(result.alignment)),
        _section("Time used", _windows_figure(result)),
        _section("Covariance of the terms", _covariance(result)),
        _section("Correlation of the terms", _correlation(result)),
        _section("Noise of the block", _noise(result)),
        _section("Go / no-go when it was concluded", _go_no_go(result)),
        _section("Block and circumstances", _facts({**result.block, **_circumstances(result)})),
        _section("Inputs", _inputs(result)),
        _section("Signatures", _signatures(result)),
    ]
    title = f"inertrim · {result.verdict}"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{STYLE}</style></head>\n<body>\n" + "\n".join(sections) + "\n</body></html>\n"
    )


def _section(title: str, body: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{body}</section>"


def _head(result: Result) -> str:
    block = " · ".join(str(value) for _, value in sorted(result.block.items()) if isinstance(value, str) and value)
    return (
        f"<header><h1>Pre-launch trim of the inertial block</h1>"
        f'<p class="dim">{escape(block)} · method {escape(result.method)} · {escape(result.software)}</p></header>'
    )


def _verdict(result: Result) -> str:
    kind = "good" if result.fit else "bad"
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in result.reasons)
    words = "navigation data are fit" if result.fit else "navigation data are not fit"
    return (
        f'<section class="verdict {kind}"><b>{MARKS[result.verdict]} {escape(result.verdict)}</b>'
        f"<p>{words} · state {escape(result.state)}</p><ul>{reasons}</ul></section>"
    )


def _identity(result: Result) -> str:
    """Tell which block, which program, which document: what a paper copy is checked by."""
    identity = result.block.get("identity") or {}
    rows = [[f"block {name.replace('_', ' ')}", str(value)] for name, value in sorted(identity.items())]
    rows += [["program", result.software], ["method", result.method], ["state", result.state]]
    rows += [["document", result.schema_], ["SHA-256 of the result", result.sha256()]]
    return _table(["", ""], rows, text=True)


def face_terms(result: Result, stage: str) -> list[float]:
    """Return a stage's six terms in mg and deg/h."""
    terms = result.terms[stage]  # type: ignore[index]
    return [value / MG_MPS2 for value in terms.f_mps2] + [value / DEG_H_RADPS for value in terms.g_radps]


def face_sigma(result: Result) -> list[float | None]:
    units = [MG_MPS2] * 3 + [DEG_H_RADPS] * 3
    values = [*result.sigma.f_mps2, *result.sigma.g_radps]
    return [None if value is None else value / unit for value, unit in zip(values, units, strict=True)]


def _terms_table(result: Result) -> str:
    stages = [stage for stage in STAGE_NAMES if stage in result.terms]
    columns = [face_terms(result, stage) for stage in stages]
    sigma = face_sigma(result)
    rows = []
    for index, sensor in enumerate(SENSORS):
        spread = sigma[index]
        final = columns[-1][index]
        cells = [_signed(column[index]) for column in columns]
        cells += ["not bounded" if spread is None else f"{spread:.4f}"]
        cells += ["" if not spread else f"{abs(final) / spread:.1f}"]
        rows.append([f"{sensor}, {'mg' if index < 3 else 'deg/h'}", *cells])
    return _table(["sensor", *(STAGE_NAMES[stage] for stage in stages), "1σ", "|term| / σ"], rows)


def _terms_figure(result: Result) -> str:
    """Draw every stage's terms as bars with the final 1σ as a whisker; accelerometers left, gyros right."""
    stages = [stage for stage in STAGE_NAMES if stage in result.terms]
    sigma = face_sigma(result)
    parts = []
    for group, unit in ((0, "mg"), (1, "deg/h")):
        values = [face_terms(result, stage)[3 * group : 3 * group + 3] for stage in stages]
        spreads = [spread or 0.0 for spread in sigma[3 * group : 3 * group + 3]]
        parts.append(_bars(values, spreads, SENSORS[3 * group : 3 * group + 3], unit, left=20 + 440 * group))
    return f'<svg viewBox="0 0 900 240" role="img" aria-label="Terms by stage">{"".join(parts)}</svg>'


def _bars(
    values: Sequence[Sequence[float]], spreads: Sequence[float], names: Sequence[str], unit: str, left: int
) -> str:
    reach = max(
        [abs(v) + s for row in values for v, s in zip(row, spreads, strict=True)] + [1e-12]
    )  # a run of all zeros still draws
    middle, scale, width = 115, 90 / reach, 24
    parts = [f'<line x1="{left}" x2="{left + 420}" y1="{middle}" y2="{middle}" stroke="currentColor" opacity=".4"/>']
    parts.append(f'<text x="{left}" y="14">{escape(unit)}, full height {reach:.3g}</text>')
    for axis, name in enumerate(names):
        base = left + 20 + 138 * axis
        for stage, row in enumerate(values):
            height = row[axis] * scale
            top = middle - max(height, 0.0)
            opacity = 0.3 + 0.7 * (stage + 1) / len(values)
            parts.append(
                f'<rect x="{base + stage * (width + 2)}" y="{top:.2f}" width="{width}" height="{abs(height):.2f}" '
                f'fill="var(--blue)" opacity="{opacity:.2f}"><title>{escape(name)}: {row[axis]:+.4f}</title></rect>'
            )
        end = base + (len(values) - 1) * (width + 2) + width / 2
        tip = middle - values[-1][axis] * scale
        reach_px = spreads[axis] * scale
        parts.append(
            f'<line x1="{end:.1f}" x2="{end:.1f}" y1="{tip - reach_px:.2f}" y2="{tip + reach_px:.2f}" '
            f'stroke="currentColor" stroke-width="2"/>'
        )
        parts.append(f'<text x="{base}" y="228">{escape(name)}</text>')
    return "".join(parts)


def _verification(result: Result) -> str:
    if result.verification is None:
        return "<p>Not reached.</p>"
    return _facts(result.verification)


def _budget(result: Result) -> str:
    budget = result.budget
    if budget is None:
        return "<p>Not predicted.</p>"
    rows = []
    without = radial_without(result, budget["time_s"])
    for index, time_s in enumerate(budget["time_s"]):
        causes = ", ".join(f"{one['cause']} {100 * one['share']:.0f} %" for one in budget["contributors"][index][:3])
        sizes = (budget["radial_m"]["50"], budget["radial_m"]["95"], budget["cep_m"])
        cells = ["not bounded" if size[index] is None else f"{size[index]:.2f}" for size in sizes]
        rows.append([f"{time_s:g} s", f"{without[index]:.2f}", *cells, causes])
    return _table(
        ["after", "without terms, m", "radial 50 %, m", "radial 95 %, m", "CEP, m", "largest contributors"], rows
    )


def _navigation_figure(result: Result) -> str:
    """Draw the error over time without the terms, and with them (95 %) at the times of the budget; logarithmic."""
    if result.budget is None:
        return ""
    ends, sizes = result.budget["time_s"], result.budget["radial_m"]["95"]
    known = [(time_s, size) for time_s, size in zip(ends, sizes, strict=True) if size]
    times = [ends[-1] * step / 30 for step in range(1, 31)]
    without = [(time_s, size) for time_s, size in zip(times, radial_without(result, times), strict=True) if size > 0]
    if not without or not known:
        return ""
    every = [math.log10(size) for _, size in (*without, *known)]
    low, high = math.floor(min(every)), math.ceil(max(every))

    def place(time_s: float, size: float) -> str:
        return f"{60 + 800 * time_s / ends[-1]:.1f},{190 - 170 * (math.log10(size) - low) / max(high - low, 1):.1f}"

    lines = [
        f'<line x1="60" x2="860" y1="{190 - 170 * (decade - low) / max(high - low, 1):.1f}" '
        f'y2="{190 - 170 * (decade - low) / max(high - low, 1):.1f}" stroke="currentColor" opacity=".15"/>'
        f'<text x="4" y="{194 - 170 * (decade - low) / max(high - low, 1):.1f}">1e{decade} m</text>'
        for decade in range(low, high + 1)
    ]
    path = " ".join(place(*point) for point in without)
    dots = "".join(
        f'<circle cx="{place(*point).split(",")[0]}" cy="{place(*point).split(",")[1]}" r="5" fill="var(--good)"/>'
        for point in known
    )
    return (
        f'<svg viewBox="0 0 900 225" role="img" aria-label="Navigation error at rest">{"".join(lines)}'
        f'<polyline points="{path}" fill="none" stroke="var(--bad)" stroke-width="2.5" stroke-dasharray="7 5"/>{dots}'
        f'<text x="60" y="216">0 to {ends[-1]:g} s · dashed: without the terms · dots: with them, 95 %</text></svg>'
    )


def _unobservable(result: Result) -> str:
    if not result.unobservable:
        return "<p>Every term was seen.</p>"
    return "<ul>" + "".join(f"<li>{escape(entry.text)}</li>" for entry in result.unobservable) + "</ul>"


def _windows_figure(result: Result) -> str:
    if not result.windows:
        return "<p>No window was used.</p>"
    start = min(window.start_s for window in result.windows)
    end = max(window.end_s for window in result.windows)
    scale = 880 / max(end - start, 1e-9)
    parts = []
    for index, window in enumerate(result.windows):
        left = 10 + (window.start_s - start) * scale
        width = (window.end_s - window.start_s) * scale
        parts.append(
            f'<rect x="{left:.1f}" y="8" width="{max(width - 2, 1):.1f}" height="22" rx="3" fill="var(--blue)" '
            f'opacity="{0.35 if index % 2 else 0.6}"/><text x="{left:.1f}" y="46">{escape(window.kind)}</text>'
            f'<text x="{left:.1f}" y="60">{window.start_s:.1f} s</text>'
        )
    return f'<svg viewBox="0 0 900 66" role="img" aria-label="Windows">{"".join(parts)}</svg>'


def _covariance(result: Result) -> str:
    rows = [
        [name, *("not bounded" if value is None else f"{value:.3e}" for value in row)]
        for name, row in zip(result.order, result.covariance, strict=True)
    ]
    return f'<div class="small">{_table(["SI", *result.order], rows)}</div>' if rows else "<p>No covariance.</p>"


def _correlation(result: Result) -> str:
    matrix = result.covariance
    if not matrix:
        return "<p>No covariance.</p>"
    rows = []
    for i, name in enumerate(result.order):
        cells = []
        for j in range(len(result.order)):
            both, first, second = matrix[i][j], matrix[i][i], matrix[j][j]
            seen = both is not None and first is not None and second is not None and first > 0 and second > 0
            cells.append(f"{both / math.sqrt(first * second):+.2f}" if seen else "–")  # type: ignore[operator]
        rows.append([name, *cells])
    return _table(["", *result.order], rows)


def _noise(result: Result) -> str:
    rows = []
    for channel in CHANNELS:
        noise = getattr(result.noise, channel)
        accelerometer = channel.startswith("accel")
        white = noise.white / (MG_MPS2 / 1000) if accelerometer else noise.white / DEG_H_RADPS / 60
        floor = noise.flicker / (MG_MPS2 / 1000) if accelerometer else noise.flicker / DEG_H_RADPS
        units = ("µg/√Hz", "µg") if accelerometer else ("deg/√h", "deg/h")
        rows.append([channel, f"{white:.4g} {units[0]}", f"{floor:.4g} {units[1]}", f"{noise.random_walk:.3g}"])
    return _table(["channel", "random walk of the increment", "bias instability", "rate random walk, SI/√s"], rows)


def _inputs(result: Result) -> str:
    rows = [[name, f"<code>{escape(digest)}</code>"] for name, digest in sorted(result.inputs.items())]
    return _table(["file", "SHA-256"], rows, raw_from=1)


def _circumstances(result: Result) -> dict[str, Any]:
    return {name: value for name, value in result.conditions.items() if name != "go_no_go"}


def _go_no_go(result: Result) -> str:
    """List the conditions as they stood; a result that was made from a recording afterwards has none."""
    rows = []
    for one in result.conditions.get("go_no_go", []):
        note = one["acknowledgement"]
        by = f"{one['state']}, by {note['by']}: {note['reason']}" if note is not None else one["state"]
        rows.append([one["name"].replace("_", " "), one["severity"], by, one["text"]])
    head = ["condition", "severity", "state", "measured"]
    return _table(head, rows, text=True) if rows else "<p>Not judged: made from a recording.</p>"


def _signatures(result: Result) -> str:
    """Leave room for those who answer for the result; the hash ties their names to this document."""
    rows = [[role, "", "", ""] for role in ("Operator", "Engineer", "Released by")]
    note = f'<p class="dim">for result {escape(result.sha256()[:16])}…, {escape(result.verdict)}</p>'
    return f'<div class="sign">{_table(["role", "name", "date", "signature"], rows, text=True)}</div>{note}'


def _facts(facts: dict[str, Any]) -> str:
    """Return nested plain data as a two-column table; keys carry the units."""
    rows = [[name, value] for name, value in _flat(facts, "")]
    return _table(["", ""], rows, text=True) if rows else "<p>Nothing recorded.</p>"


def _flat(value: Any, prefix: str) -> Iterable[tuple[str, str]]:
    if isinstance(value, dict):
        for key in sorted(value):  # a result read back from its file has its keys in this order
            yield from _flat(value[key], f"{prefix} · {key}" if prefix else str(key))
    else:
        yield prefix.replace("_", " "), _plain(value)


def _plain(value: Any) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(_plain(item) for item in value)
    return str(value)


def _signed(value: float) -> str:
    return f"{value:+.4f}"


def _table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, raw_from: int | None = None, text: bool = False
) -> str:
    """Return a table; cells are escaped but for columns from ``raw_from`` on, which are HTML already."""
    kind = ' class="text"' if text or raw_from is not None else ""
    top = "".join(f"<th{kind}>{escape(name)}</th>" for name in head) if any(head) else ""
    body = []
    for row in rows:
        cells = [cell if raw_from is not None and index >= raw_from else escape(cell) for index, cell in enumerate(row)]
        body.append("<tr>" + "".join(f"<td{kind}>{cell}</td>" for cell in cells) + "</tr>")
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'
