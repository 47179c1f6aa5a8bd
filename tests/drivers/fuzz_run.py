"""Fuzz the reading of lines and say what was done: ``python tests/drivers/fuzz_run.py ENGINE --inputs N --json F``.

``coverage`` is libFuzzer in this process, by atheris: single inputs, led by what code they reach; compiled code runs
and is not instrumented. ``storm`` mutates the corpus blindly into long streams, for many more inputs in the same time.
An exception, a hang, or a gibibyte ends either with an exit code other than 0.
"""

from __future__ import annotations

import argparse
import importlib
import json
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HANG_S, HANG_ELAPSED_S, MAX_MEGABYTES = 10, 300, 1024
"""Processor time that a storm may take, time that libFuzzer gives an input (it knows no other, and an idle process may
have to wait for its turn), memory."""
STORM = 500
REPORT_EVERY_S = 5.0


def compiled_modules() -> list[str]:
    """Return the modules that hold compiled code: instrumented, they would not compile."""
    root = Path(__file__).resolve().parents[2]
    return [
        ".".join(path.relative_to(root).with_suffix("").parts)
        for path in (root / "drivers").rglob("*.py")
        if path.stem == "compiled" or "from drivers.compiled import" in path.read_text()
    ]


class Report:
    """What has been done so far, kept in a file as it goes: libFuzzer ends the process itself."""

    def __init__(self, path: Path | None, **about: Any) -> None:
        self._path, self._about = path, about
        self.inputs, self._slowest_s, self._began, self._told = 0, 0.0, time.monotonic(), 0.0

    def add(self, inputs: int, seconds: float, last: bool) -> None:
        """Count inputs that took ``seconds`` together."""
        self.inputs += inputs
        self._slowest_s = max(self._slowest_s, seconds / inputs)
        now = time.monotonic()
        if self._path is not None and (last or now - self._told > REPORT_EVERY_S):
            self._told = now
            self._path.write_text(json.dumps({**self._about, **self.facts()}) + "\n")

    def facts(self) -> dict[str, float]:
        """Return inputs, time of the slowest, peak memory, elapsed and processor time."""
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        elapsed_s, cpu_s = time.monotonic() - self._began, time.process_time()
        return {
            "inputs": self.inputs,
            "slowest_s": self._slowest_s,
            "peak_mb": peak_mb,
            "elapsed_s": elapsed_s,
            "processor_s": cpu_s,
        }


def coverage(asked: argparse.Namespace, report: Report) -> None:
    """Run libFuzzer."""
    import atheris

    with atheris.instrument_imports(include=["drivers"], exclude=compiled_modules()):
        target = importlib.import_module("fuzz_target")

    def counted(data: bytes) -> None:
        start = time.perf_counter()
        target.one_input(data)
        report.add(1, time.perf_counter() - start, report.inputs + 1 == asked.inputs)

    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(target.seeds()):
            Path(folder, f"{number:04}").write_bytes(seed)
            target.one_input(seed)  # compiles, so that no input is slow for that
        options = {
            "runs": asked.inputs,
            "seed": asked.seed,
            "max_len": target.LONGEST_INPUT,
            "timeout": HANG_ELAPSED_S,
            "rss_limit_mb": MAX_MEGABYTES,
            "verbosity": 0,
        }
        atheris.Setup([sys.argv[0], *(f"-{name}={value}" for name, value in options.items()), folder], counted)
        atheris.Fuzz()


def storm(asked: argparse.Namespace, report: Report) -> None:
    """Run storms over the protocols in turn; one that hangs is ended by a signal."""
    target = importlib.import_module("fuzz_target")
    seed = asked.seed << 32
    resource.setrlimit(resource.RLIMIT_DATA, (MAX_MEGABYTES << 20, MAX_MEGABYTES << 20))
    while report.inputs < asked.inputs:
        for which in range(len(target.PROTOCOLS)):
            seed += 1
            start = time.perf_counter()
            signal.setitimer(signal.ITIMER_VIRTUAL, HANG_S)  # kills
            try:
                target.storm(which, seed, STORM)
            except BaseException:
                print(f"storm({which}, {seed}, {STORM}) fails; {target.NAMES[which]}", file=sys.stderr)
                raise
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            report.add(STORM, time.perf_counter() - start, report.inputs + STORM >= asked.inputs)


def main() -> None:
    """Run one engine until its inputs are used up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("engine", choices=("coverage", "storm"))
    parser.add_argument("--inputs", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    report = Report(asked.json, engine=asked.engine, seed=asked.seed)
    {"coverage": coverage, "storm": storm}[asked.engine](asked, report)


if __name__ == "__main__":
    main()
