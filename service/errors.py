"""What a user gave and the service cannot take."""

from __future__ import annotations


class RefusedInput(ValueError):
    """An input is refused; the text names the place, the reason and the remedy."""

    def __init__(self, place: str, reason: str, remedy: str) -> None:
        super().__init__(f"{place}: {reason} {remedy}")
        self.place, self.reason, self.remedy = place, reason, remedy
