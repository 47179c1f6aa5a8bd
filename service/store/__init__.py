"""What outlives the process: runs, transitions, results, audit and idempotency keys in one SQLite file."""

from __future__ import annotations

from service.store.store import RunRecord, Store, StoreError, TransitionRecord, utc_now

__all__ = ["RunRecord", "Store", "StoreError", "TransitionRecord", "utc_now"]
