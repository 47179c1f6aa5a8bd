"""A real STIM300 power-up, played onto a pty as a live device's: the service takes it through power-up and settling."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from drivers.protocols import get_protocol
from service.config import load_settings
from service.controller import Controller
from service.playback import play

WINDOW = {"settling_window_s": 2.4, "accel_drift_mg_per_min": 100.0, "gyro_drift_dph_per_min": 1e5}


def test_power_up_and_settling_run_on_a_real_power_up(shared_data: Path, tmp_path: Path) -> None:
    """Frames flagged start-up, no self-test to ask for, settling on its evidence; and no frame lost on the way."""
    file = shared_data / "captures" / "stim300_0x93_powerup_2000Hz_30g.hex"
    config = tmp_path / "settings.toml"
    config.write_text(
        f"""
        [link]
        url = "{tmp_path / "tty"}"
        protocol = "stim300"
        options = {{ accel_range_g = "30" }}
        [site]
        latitude_deg = 49.3
        height_m = 80.0
        [reference]
        azimuth_deg = 10.0
        azimuth_sigma_deg = 0.1
        [block]
        gyro_kind = "mems"
        [store]
        path = "{tmp_path / "inertrim.db"}"
        """
    )
    settings = load_settings(config)
    short = settings.sequence.model_copy(update=WINDOW)  # the capture is shorter than any window that may be configured
    controller = Controller(settings.model_copy(update={"sequence": short}))
    controller.start()
    run_id, _ = controller.start_run({"method": "paper", "azimuth_deg": None, "operator": "test"}, "test")
    player = threading.Thread(target=play, args=(file, get_protocol("stim300", accel_range_g="30"), tmp_path / "tty"))
    player.start()
    try:
        end = time.monotonic() + 60
        while controller.status().facts["state"] not in ("ALIGNING", "HOLD", "FAULT"):
            assert time.monotonic() < end, controller.status().facts
            time.sleep(0.02)
        player.join(20)
        while len(changes := passed(controller, run_id)) < 4:
            assert time.monotonic() < end, changes
            time.sleep(0.02)
        assert changes[:3] == [
            ("POWER_UP", "start"),
            ("SELF_TEST", "streaming"),
            ("SETTLING", "self_test_passed"),
        ]
        assert changes[3] == ("ALIGNING", "settled")
        assert controller.line is not None
        # Every frame of the capture came through whole. Gaps are not asked for: where the host halts the player itself,
        # frames come late for good, and the counter, which wraps every 0.128 s, cannot tell that from frames lost.
        while (counts := controller.line.counters())["frames"] < 8392:
            assert time.monotonic() < end, counts
            time.sleep(0.02)
        assert (counts["frames"], counts["crc_failures"]) == (8392, 0)
    finally:
        player.join(20)
        controller.stop()


def passed(controller: Controller, run_id: str) -> list[tuple[str, str]]:
    """Return the states that a run has reached, and why."""
    record = controller.store.run(run_id)
    assert record is not None
    return [(one["target"], one["reason"]) for one in record.transitions]
