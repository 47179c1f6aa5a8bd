"""``report.html``: one file without anything from outside; figures are inline SVG."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.allan import overlapping_allan
from inertial.documents import CHANNELS
from simulators.discrepancy.gap import adopted_rates
from simulators.discrepancy.words import alternatives

if TYPE_CHECKING:
    from simulators.discrepancy.report import Report

Array = NDArray[np.float64]

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1c2430}
h1{font-size:1.5rem}h2{font-size:1.1rem;margin-top:2rem;border-bottom:1px solid #ccd}table{border-collapse:collapse}
td,th{padding:.2rem .7rem;text-align:left;border-bottom:1px solid #e4e7ee;font-variant-numeric:tabular-nums}
.verdict{display:inline-block;padding:.1rem .7rem;border-radius:1rem;background:#e5ecf6}
svg{width:100%;height:auto;background:#fafbfd;border:1px solid #e4e7ee;margin:.4rem 0}
figcaption{color:#556;font-size:.9rem}"""
_COLOURS = ("#7a869a", "#c2410c", "#1d4ed8", "#15803d")
_POINTS = 400


def render(report: Report) -> str:
    """Return the page."""
    document = report.document
    channels = _channels(report)
    parts = [
        f"<h1>Simulation against measurement <span class=verdict>{document['verdict']}</span></h1>",
        f"<p>{html.escape(document['text'])}</p>",
        "<h2>What was found</h2>",
        _findings(document),
        "<h2>The gap, step by step</h2>",
        _gap(document),
    ]
    for channel in channels:
        parts += [f"<h2>{CHANNELS[channel]}</h2>", *_figures(report, channel)]
    parts += ["<h2>Where</h2>", _where(document), "<h2>What to record next</h2>", _next(document), _inputs(document)]
    body = "\n".join(parts)
    head = f"<meta charset=utf-8><title>inertrim: discrepancy</title><style>{_STYLE}</style>"
    return f"<!doctype html><html lang=en><head>{head}</head><body>{body}</body></html>\n"


def _channels(report: Report) -> list[int]:
    """Return the channels worth a figure: those with a finding, or the one with most left."""
    names = " ".join(f["channel"].partition("<-")[0] for f in report.document["findings"])
    names += " ".join(t["channel"] for t in report.document["remaining"]["empirical"])
    chosen = [c for c, name in enumerate(CHANNELS) if name in names]
    if not chosen:
        worst = max(report.document["where"], key=lambda row: row["before"])
        chosen = [CHANNELS.index(worst["channel"])]
    return chosen[:4]


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    lines = "".join("<tr>" + "".join(f"<td>{html.escape(_plain(v))}</td>" for v in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{lines}</table>"


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "–" if value is None else str(value)


def _findings(document: dict[str, Any]) -> str:
    rows = []
    for finding in document["findings"]:
        sizes = "; ".join(
            f"{name} {_plain(float(p['value']))} ± {_plain(p['sigma'])} {p['unit']}"
            for name, p in finding["parameters"].items()
        )
        others = ", ".join(alternatives(finding)) or "none"
        behind = ", ".join(
            f"{a['effect']} on {a['channel']} ({a['behind_nats']:.0f})" for a in finding["runners_up"][:4]
        )
        rows.append(
            [
                finding["effect"],
                finding["channel"],
                sizes,
                finding["evidence_nats"],
                finding["confidence"],
                others,
                behind,
            ]
        )
    for term in document["remaining"]["empirical"]:
        rows.append(["(unknown)", term["channel"], term["term"], term.get("evidence_nats"), None, "", ""])
    if not rows:
        return "<p>Nothing: what is left is noise.</p>"
    head = ["effect", "channel", "size", "evidence, nats", "confidence", "cannot be told from", "behind by, nats"]
    return _table(head, rows)


def _gap(document: dict[str, Any]) -> str:
    gap = document["gap"]
    rows = [[step["added"], step["whitened_rms"]] for step in gap["steps"]]
    table = _table(["with", "whitened RMS (noise alone: 1)"], rows)
    held, navigation = gap["heldout_rms"], gap["navigation_m"]
    facts = [
        ["whitened RMS, data not seen by the fit", held["before"], held["after"]],
        ["share of variance that is no noise", gap["structured_share"]["before"], gap["structured_share"]["after"]],
        *[
            [f"navigation apart after {t} s, m", navigation["before"][t], navigation["after"][t]]
            for t in navigation["before"]
        ],
    ]
    return table + "<p></p>" + _table(["", "before", "after"], facts)


def _figures(report: Report, channel: int) -> list[str]:
    scene, search = report.scenes[0], report.search
    added = adopted_rates(search, 0)[:, channel]
    n = len(added)
    time_s = scene.time_s[scene.group - 1 :: scene.group][:n]
    measured = scene.analysed(scene.measured[:, channel], channel)[:n]
    predicted = scene.analysed(scene.predicted[:, channel], channel)[:n]
    thin = max(1, n // _POINTS)
    m, p, a, t = (_means(v, thin) for v in (measured, predicted, added, time_s))
    unit = "m/s²" if channel < 3 else "rad/s"
    figures = [
        _figure(f"measured, model before, model after [{unit}] over time [s]", t, [m, p, p + a]),
        _figure(f"residual before and after [{unit}] over time [s]", t, [m - p, m - p - a]),
    ]
    basis, fit, bare = search.evidence.basis[0, channel], search.fit, search.bare
    frequency = np.maximum(basis.frequency_hz, 0.25 * basis.frequency_hz[1])
    spectra = [f.rss[0, channel] / basis.counts for f in (bare, fit)] + [fit.noise[0, channel].power]
    figures.append(
        _figure("power of the residual before, after, and of the noise, over Hz", frequency, spectra, log=True)
    )
    curves = [overlapping_allan(v, scene.interval_s) for v in (measured - predicted, measured - predicted - added)]
    whitened = search.fit.noise[0, channel].power
    noise = np.asarray(idct(basis.each(np.sqrt(whitened)) * _draw(n), norm="ortho"))
    own = overlapping_allan(noise, scene.interval_s)
    deviations = [c.deviation for c in curves] + [own.deviation]
    figures.append(
        _figure("Allan deviation before, after, and of the noise model, over s", own.averaging_s, deviations, log=True)
    )
    if scene.warm and float(np.ptp(scene.seen.temperature_c)) > 0.3:
        warmth = _means(scene.analysed(scene.seen.temperature_c[:, 0], channel)[:n], thin)
        order = np.argsort(warmth)
        left = [(m - p)[order], (m - p - a)[order]]
        figures.append(_figure(f"residual before and after [{unit}] over °C", warmth[order], left))
    return figures


def _draw(n: int) -> Array:
    return np.random.default_rng(0).standard_normal(n)


def _means(values: Array, size: int) -> Array:
    return np.asarray(values[: len(values) // size * size].reshape(-1, size).mean(axis=1))


def _figure(caption: str, x: Array, lines: Sequence[Array], *, log: bool = False) -> str:
    """Return lines over x as SVG, 900 × 220."""
    kept = [np.asarray(line, dtype=np.float64) for line in lines]
    across = np.asarray(x, dtype=np.float64)
    if log:
        across = np.log10(np.maximum(across, 1e-12))
        floor = max(min(float(line[line > 0].min(initial=1.0)) for line in kept), 1e-300)
        kept = [np.log10(np.maximum(line, floor)) for line in kept]
    low, high = min(float(k.min()) for k in kept), max(float(k.max()) for k in kept)
    left, right = float(across.min()), float(across.max())
    height, width = max(high - low, 1e-300), max(right - left, 1e-300)
    paths = []
    for line, colour in zip(kept, _COLOURS, strict=False):
        points = " ".join(
            f"{60 + 830 * (a - left) / width:.1f},{10 + 185 * (high - b) / height:.1f}"
            for a, b in zip(across, line, strict=True)
        )
        paths.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.2"/>')
    ends = [(60, 214, left), (840, 214, right), (2, 18, high), (2, 196, low)]
    labels = "".join(
        f'<text x="{u}" y="{v}" font-size="11" fill="#556">{10**w if log else w:.3g}</text>' for u, v, w in ends
    )
    names = ", ".join(f'<span style="color:{c}">—</span>' for c, _ in zip(_COLOURS, kept, strict=False))
    svg = f'<svg viewBox="0 0 900 220" role="img">{"".join(paths)}{labels}</svg>'
    return f"<figure>{svg}<figcaption>{html.escape(caption)} ({names} in this order)</figcaption></figure>"


def _where(document: dict[str, Any]) -> str:
    rows = sorted(document["where"], key=lambda row: -row["before"])[:12]
    head = ["channel", "from, s", "to, s", "regime", "°C", "before", "after"]
    keys = ["channel", "start_s", "end_s", "regime", "temperature_c", "before", "after"]
    return "<p>Whitened RMS by segment, the worst first.</p>" + _table(head, [[row[k] for k in keys] for row in rows])


def _next(document: dict[str, Any]) -> str:
    rows = [[p["text"], p["about"], p["expected_nats"]] for p in document["next_recording"]]
    return _table(["recording", "about", "expected evidence, nats"], rows) if rows else "<p>Nothing is in doubt.</p>"


def _inputs(document: dict[str, Any]) -> str:
    return "<h2>Inputs</h2>" + _table(["file", "SHA-256"], sorted(document["inputs"].items()))
