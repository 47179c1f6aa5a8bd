"""The verdict as a paragraph that can be read aloud."""

from __future__ import annotations

from typing import Any

_FACES = {
    "m/s^2": (1e3 / 9.80665, "mg"),
    "rad/s": (206264.80624709636, "deg/h"),
    "rad": (57.29577951308232, "deg"),
    "rad/s/(m/s^2)": (206264.80624709636 * 9.80665, "deg/h/g"),
}

_LISTED = 3  # outliers


def in_words(document: dict[str, Any]) -> str:
    """Return what a report's document says, in plain words."""
    sentences: list[str] = []
    findings = document["findings"]
    if document["verdict"] == "none":
        sentences.append("Model and measurement agree: what is left is noise, and nothing needs a name.")
    for finding in findings:
        sentences.append(_finding(finding))
    sentences += _unnamed(document["remaining"]["empirical"])
    for term in document["remaining"]["misfits"]:
        sentences.append(f"The {term['of'].replace('_', ' ')} fits to a few per cent only ({term['term']} is left).")
    if outliers := document["outliers"]:
        at = ", ".join(f"{one['channel']} at {one['time_s']:.2f} s" for one in outliers[:_LISTED])
        more = f" and {len(outliers) - _LISTED} more" if len(outliers) > _LISTED else ""
        sentences.append(f"Single wild samples were taken out: {at}{more}.")
    sentences += document["remarks"]
    for reference in document["reference"]:
        sentences.append(f"The reference is off: {reference['text']}; this is not laid to the block.")
    gap = document["gap"]["heldout_rms"]
    if findings:
        sentences.append(
            f"On data that the fit did not see, the whitened gap goes from {gap['before']:.3f} to {gap['after']:.3f}, "
            "where noise alone is 1."
        )
        before, after = (document["gap"]["navigation_m"][k].get("60") for k in ("before", "after"))
        if before is not None and after is not None:
            sentences.append(
                f"After a minute of navigation the two are {before:.2f} m apart before, {after:.2f} m after."
            )
    if document["next_recording"]:
        best = document["next_recording"][0]
        sentences.append(
            f"To be surer about {best['about'].replace('_', ' ')}, record {best['text']}: "
            f"{best['expected_nats']:.0f} nats of evidence are to be expected."
        )
    return " ".join(sentences)


def _unnamed(terms: list[dict[str, Any]]) -> list[str]:
    """Return a sentence for each kind of structure, with all its channels."""
    channels: dict[str, list[str]] = {}
    for term in terms:
        channels.setdefault(term["term"], []).append(term["channel"])
    return [
        f"On {' and '.join(', '.join(on).rsplit(', ', 1))} there is structure that no effect in the library explains "
        f"({what}); it is marked as empirical, for an engineer to name."
        for what, on in channels.items()
    ]


def _finding(finding: dict[str, Any]) -> str:
    name = finding["effect"].replace("_", " ")
    sizes = ", ".join(_value(n, p) for n, p in finding["parameters"].items())
    text = f"There is a {name} on {finding['channel']}{f' ({sizes})' if sizes else ''}"
    if finding["alternatives"]:
        text += f"; this data cannot tell it from {' or '.join(alternatives(finding))}"
    return text + "."


def alternatives(finding: dict[str, Any]) -> list[str]:
    """Return what ties with a finding, two names that do so only together as one."""
    own = _named(finding)
    texts: dict[frozenset[str], str] = {}
    for one in finding["alternatives"]:
        names = [_named(other) for other in (one, one.get("together_with")) if other]
        text = " with ".join("it counted from the usual" if name == own else name for name in names)
        if but := one.get("in_place_of_both"):
            text += f" in the place of it and the {_named(but)}"
        texts.setdefault(frozenset(names), text)
    return list(texts.values())


def _named(one: dict[str, Any]) -> str:
    return f"{one['effect'].replace('_', ' ')} on {one['channel']}"


def _value(name: str, parameter: dict[str, Any]) -> str:
    factor, unit = _FACES.get(parameter["unit"], (1.0, parameter["unit"]))
    sigma = parameter["sigma"]
    spread = f" ± {sigma * factor:.2g}" if sigma else ""
    return f"{name.replace('_', ' ')} {parameter['value'] * factor:.4g}{spread} {unit}".replace(" 1", "", 0)
