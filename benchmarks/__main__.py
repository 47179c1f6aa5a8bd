"""Run every benchmark and rewrite the README's tables from what they measured.

A benchmark is a module of this package with a command line that takes ``--json FILE``. Its JSON may hold
``table: {"header": [...], "rows": [[...], ...]}``; that table replaces what stands in the README between
``<!-- bench:NAME -->`` and ``<!-- /bench -->``.
"""

from __future__ import annotations

import argparse
import json
import pkgutil
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

README = Path(__file__).resolve().parent.parent / "README.md"


FIELD_LIFE = "soak"
"""Takes an hour and measures no speed: `make long` runs it."""


def names() -> list[str]:
    """Return the benchmarks in alphabetical order; those that begin with ``_`` are helpers."""
    modules = pkgutil.iter_modules([str(Path(__file__).parent)])
    return sorted(module.name for module in modules if not module.name.startswith("_") and module.name != FIELD_LIFE)


def measure(name: str, folder: Path) -> dict[str, Any]:
    """Run one benchmark in a process of its own and return its JSON."""
    out = folder / f"{name}.json"
    print(f"== {name}", flush=True)
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}", "--json", str(out)], check=True)
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def markdown(table: dict[str, Any]) -> str:
    """Render a header and rows as a Markdown table."""
    lines = [table["header"], ["---"] * len(table["header"]), *table["rows"]]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def replace_table(readme: str, name: str, table: dict[str, Any]) -> str:
    """Return the README text with the table of one benchmark renewed."""
    pattern = re.compile(rf"(<!-- bench:{re.escape(name)} -->\n).*?(<!-- /bench -->)", re.DOTALL)
    return pattern.sub(lambda found: f"{found[1]}{markdown(table)}\n{found[2]}", readme)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("only", nargs="*", help="names of benchmarks (default: all)")
    parser.add_argument("--json", type=Path, help="also write all figures to this file")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.only) - set(names()))
    if unknown:
        parser.error(f"no benchmark named {', '.join(unknown)}; there are: {', '.join(names())}")
    with tempfile.TemporaryDirectory() as folder:
        figures = {name: measure(name, Path(folder)) for name in arguments.only or names()}
    readme = README.read_text()
    for name, found in figures.items():
        if "table" in found:
            readme = replace_table(readme, name, found["table"])
    README.write_text(readme)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
