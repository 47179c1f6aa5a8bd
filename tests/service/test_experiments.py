"""The paper's third test made again, and the tables that show it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.experiments import block
from service.experiments.run import planted_shift
from service.experiments.tables import tables_text


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return planted_shift(tmp_path_factory.mktemp("third"))


@pytest.mark.parametrize("method", ["paper", "optimal"])
def test_only_the_raised_gyro_moves_and_navigation_does_not(facts: dict, method: str) -> None:  # type: ignore[type-arg]
    before, after = (np.array(facts[name]["terms"][method]["final"]) for name in ("original", "raised"))
    moved = after - before
    assert moved[4] == pytest.approx(-block.RAISED_BY * block.GYRO_Y_BIAS_DPH, abs=1e-3)
    assert moved[4] == pytest.approx(1.500 - -0.440, abs=1e-3)  # the paper's Table 3
    assert np.max(np.abs(np.delete(moved, 4))) < 0.007  # and what it says of the others
    ends = [facts[name]["navigation"][method] for name in ("original", "raised")]
    assert ends[0]["position_m"] == pytest.approx(ends[1]["position_m"], abs=0.01)
    assert ends[0]["final_radial_m"] < 0.5 * facts["original"]["navigation"]["none"]["final_radial_m"]


def test_storage_law_keeps_x_steadier_and_starts_at_nothing(tmp_path: Path) -> None:
    del tmp_path
    bias, scale = block.ageing()
    assert block.drift(0.0) == 0.0
    for change in (bias, scale):
        assert np.std(change[:, 0]) < 0.6 * np.std(change[:, 1:])


def test_tables_put_the_papers_digits_beside_ours(facts: dict) -> None:  # type: ignore[type-arg]
    test = {**facts["original"], "planted": [0.0] * 6}
    storage = {"vertical_term_due_mg": [0.1], "vertical_term_found_mg": {"paper": [0.1], "optimal": [0.1]}}
    text = tables_text({"dynamic": test, "vibration": test, "planted_shift": facts, "storage": storage})
    assert "−0.440 → +1.500" in text
    assert text.count("**Table") == 4
