"""What outlives the process: runs, transitions, results, audit, tokens and idempotency keys in one database."""

from __future__ import annotations

from service.store.carried import Carried
from service.store.errors import StoreError
from service.store.store import LAUNCHER, RunRecord, Store, TokenRecord, TransitionRecord, utc_now

__all__ = ["LAUNCHER", "Carried", "RunRecord", "Store", "StoreError", "TokenRecord", "TransitionRecord", "utc_now"]
