"""The paper's laboratory made again on a simulated block (docs/experiments.md)."""

from __future__ import annotations

from service.experiments.run import run_experiments

__all__ = ["run_experiments"]
