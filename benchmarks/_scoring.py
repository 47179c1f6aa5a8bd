"""Right, tied, wrong or missed: a report of the discrepancy workflow against the sealed truth of its case."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import beta, binom

Name = tuple[str, str]
NOISE_NAMES = frozenset({"random_walk", "bias_instability", "rate_random_walk", "quantisation"})
TIE_NATS = 3.0
HELD_OUT_LIMIT = 1.1
BINS = ((0, 6), (6, 9), (9, 20), (20, 40), (40, float("inf")))
_NOT_ESTIMATED = frozenset({"reference", "nominal", "rides"})


def normal(effect: str, channel: str) -> Name:
    """An exchange of two sensors has two spellings; return the first."""
    first, arrow, second = channel.partition("<-")
    if effect == "axis_swap" and arrow and second < first:
        return effect, f"{second}<-{first}"
    return effect, channel


def names_of(finding: dict[str, Any]) -> list[Name]:
    """The name of a finding and those tied with it."""
    tied = [a for a in finding["alternatives"] if a.get("behind_nats", 0.0) <= TIE_NATS]
    return [normal(f["effect"], f["channel"]) for f in (finding, *tied)]


def score(truth: dict[str, Any], outcome: dict[str, Any]) -> dict[str, Any]:
    """Compare one case's outcome with its truth; an outcome with ``error`` found nothing and is wrong."""
    report = outcome.get("report", {"verdict": "error", "findings": []})
    found = [names_of(finding) for finding in report["findings"]]
    hidden = [normal(e["effect"], e["channel"]) for e in truth["effects"]]
    allowed = {normal(*name) for name in truth["allowed"]}
    effects = []
    for entry, name in zip(truth["effects"], hidden, strict=True):
        firsts = [names for names in found if names[0] == name]
        ties = [names for names in found if name in names]
        verdict = "named" if firsts else "tied" if ties else "missed"
        size = len((firsts or ties or [[]])[0])
        sizes = {key: entry[key] for key in ("d", "d_got")}
        effects.append({"effect": name[0], "channel": name[1], **sizes, "outcome": verdict, "tie_size": size})
    false = [names[0] for names in found if not (set(names) & ({*hidden, *allowed}))]
    estimates = [] if truth["family"] == "near_copy" else list(_inside(truth, report))
    held_out = [f["heldout_after"] for f in report["findings"] if f.get("heldout_after") is not None]
    keys = ("number", "category", "family", "motion", "climate", "kind", "free", "length_s", "strange", "d")
    return {
        **{key: truth[key] for key in keys if key in truth},
        "verdict": report["verdict"],
        "effects": effects,
        "findings": [list(names[0]) for names in found],
        "tie_sizes": [len(names) for names in found],
        "false": [list(name) for name in false],
        "false_deterministic": [list(name) for name in false if name[0] not in NOISE_NAMES],
        "inside_95": estimates,
        "heldout_after": held_out,
        "seconds": outcome.get("seconds"),
        "error": outcome.get("error"),
    }


def _inside(truth: dict[str, Any], report: dict[str, Any]) -> Iterable[bool]:
    """Whether each parameter of a rightly named effect lies inside its stated 95 % interval."""
    for entry in truth["effects"]:
        name = normal(entry["effect"], entry["channel"])
        for finding in report["findings"]:
            if normal(finding["effect"], finding["channel"]) != name:
                continue
            for key, value in finding["parameters"].items():
                if key in entry["parameters"] and key not in _NOT_ESTIMATED and value.get("sigma"):
                    yield bool(abs(value["value"] - entry["parameters"][key]) <= 1.96 * value["sigma"])
            break


def share(flags: Iterable[bool]) -> float | None:
    """Fraction of trues; none of nothing."""
    values = list(flags)
    return float(np.mean(values)) if values else None


def flags(rows: Sequence[dict[str, Any]]) -> dict[str, list[bool]]:
    """What each fraction is counted over."""
    inside = [r for r in rows if r["category"] == "inside"]
    nulls = [r for r in rows if r["category"] == "null"]
    outside = [r for r in rows if r["category"] == "outside"]
    every = [e for r in inside for e in r["effects"]]
    strong = [e for e in every if e["d"] >= 10]
    several = [r for r in inside if len(r["effects"]) > 1]
    return {
        "named_or_tied": [e["outcome"] != "missed" for e in strong],
        "named": [e["outcome"] == "named" for e in strong],
        "wrong_name": [bool(r["false"]) for r in inside if max(e["d"] for e in r["effects"]) >= 10],
        "named_or_tied_got": [e["outcome"] != "missed" for e in every if e["d_got"] >= 10],
        "named_or_tied_d7": [e["outcome"] != "missed" for e in every if 6 <= e["d"] < 9],
        "named_or_tied_d7_got": [e["outcome"] != "missed" for e in every if 6 <= e["d_got"] < 9],
        "several_recall": [e["outcome"] != "missed" for r in several for e in r["effects"]],
        "several_precision": [i >= len(r["false"]) for r in several for i in range(len(r["findings"]))],
        "false_alarm": [bool(r["false"]) for r in nulls],
        "false_deterministic": [bool(r["false_deterministic"]) for r in nulls],
        "null_called_unknown": [r["verdict"] in ("unknown", "error") for r in nulls],
        "unknown_flagged": [r["verdict"] == "unknown" for r in outside if r["d"] >= 30],
        "unknown_flagged_d60": [r["verdict"] == "unknown" for r in outside if r["d"] >= 60],
        "outside_false_deterministic": [bool(r["false_deterministic"]) for r in outside if r["d"] >= 30],
        "heldout_gap_closed": [max(r["heldout_after"]) <= HELD_OUT_LIMIT for r in rows if r["heldout_after"]],
    }


def figures(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All fractions of a set of scored cases."""
    return {
        **{name: share(values) for name, values in flags(rows).items()},
        "mean_tie_size": float(np.mean([s for r in rows for s in r["tie_sizes"]] or [0.0])),
        "errors": sum(r["error"] is not None for r in rows),
    }


def bands(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """For each fraction how many of how many, and the 95 % interval of what it estimates (Clopper and Pearson 1934)."""
    found: dict[str, dict[str, Any]] = {}
    for name, values in flags(rows).items():
        k, n = sum(values), len(values)
        low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
        high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
        found[name] = {"counted": k, "of": n, "interval_95": [low, high]}
    return found


def coverage(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Share of parameters inside their 95 % interval and the 99.9 % binomial band of that share."""
    flags = [flag for r in rows for flag in r["inside_95"]]
    if not flags:
        return {"parameters": 0}
    low, high = (float(end) / len(flags) for end in binom.interval(0.999, len(flags), 0.95))
    return {"parameters": len(flags), "inside": float(np.mean(flags)), "band": [low, high]}


def by_effect(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, dict[str, int]]]:
    """Outcomes by effect and size: named, tied, missed."""
    table: dict[str, dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for row in rows:
        for e in row["effects"]:
            low, high = next(b for b in BINS if b[0] <= e["d"] < b[1])
            table[e["effect"]][f"{low:g}-{high:g}"][e["outcome"]] += 1
    return {effect: {size: dict(counts) for size, counts in sorted(table[effect].items())} for effect in sorted(table)}


def confusion(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, dict[str, int]]]:
    """What each hidden effect (of single ones, or *nothing*, or a strange one) was called, by size."""
    table: dict[str, dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for row in rows:
        if len(row["effects"]) > 1:
            continue
        truth = row["effects"][0]["effect"] if row["effects"] else row.get("strange", "nothing")
        d = row["effects"][0]["d"] if row["effects"] else row.get("d", 0.0)
        low, high = next(b for b in BINS if b[0] <= d < b[1])
        for name in {f[0] for f in row["findings"]} | ({row["verdict"]} & {"none", "unknown", "error"}):
            table[truth][f"{low:g}-{high:g}"][name] += 1
    return {
        truth: {size: dict(names.most_common()) for size, names in sorted(table[truth].items())}
        for truth in sorted(table)
    }


PEER_NAMES = frozenset(
    [
        "bias_shift",
        "bias_step",
        "drift",
        "turn_on_transient",
        "bias_temperature",
        "scale_temperature",
        "thermal_lag",
        "scale_factor",
        "scale_asymmetry",
        "scale_quadratic",
        "scale_cubic",
        "misalignment",
        "g_sensitivity",
        "g2_sensitivity",
        "vibration_rectification",
        "size_effect",
        "sinusoid",
        "supply_sensitivity",
        "azimuth_error",
        "latitude_error",
        "gravity_error",
        "level_error",
    ]
)
"""What is in the peers' list of regressors; they are compared on nothing else."""


def peer_figures(truths: Sequence[dict[str, Any]], named: Sequence[Sequence[Sequence[str]]]) -> dict[str, Any]:
    """The same questions to a method that gives names without ties."""
    recall, exact, false, nulls, strange = [], [], [], [], []
    for truth, names in zip(truths, named, strict=True):
        given = {normal(*name) for name in names}
        hidden = {normal(e["effect"], e["channel"]) for e in truth["effects"]}
        allowed = {normal(*name) for name in truth["allowed"]}
        if truth["category"] == "null":
            nulls.append(bool(given - allowed))
        elif truth["category"] == "outside":
            strange.append(bool({n for n in given if n[0] not in NOISE_NAMES}))
        elif all(e["effect"] in PEER_NAMES and e["d"] >= 10 for e in truth["effects"]):
            recall += [name in given for name in hidden]
            exact.append(given - allowed == hidden)
            false.append(len(given - hidden - allowed))
    return {
        "truth_in_set": share(recall),
        "exactly_the_truth": share(exact),
        "false_names_a_case": float(np.mean(false)) if false else None,
        "null_with_a_name": share(nulls),
        "strange_with_a_name": share(strange),
        "cases": len(exact),
    }
