"""What the store cannot be opened or used for."""

from __future__ import annotations


class StoreError(RuntimeError):
    """The store cannot be used; the text names the file or server, the reason and the remedy."""
