"""What machines watch: metrics in the Prometheus text format (docs/metrics.md lists them)."""

from __future__ import annotations

from service.metrics.exposition import CONTENT_TYPE, Metrics

__all__ = ["CONTENT_TYPE", "Metrics"]
