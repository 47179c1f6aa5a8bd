"""Fixtures of the drivers' tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from driver_bench import Cable


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    """A plugged-in cable."""
    cable = Cable(tmp_path / "ttyINS")
    cable.plug()
    yield cable
    cable.unplug()
