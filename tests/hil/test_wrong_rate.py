"""A block that is slower than stated, as KVH users met one: the console reads so, whatever the state."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np

from drivers.capture import CaptureWriter
from drivers.protocols import get_protocol
from drivers.samples import empty_samples
from service.config import load_settings
from service.controller import Controller
from service.playback import play

TRUE_HZ, STATED_HZ = 96.24, 100.0
SPEED, DURATION_S = 5.0, 75.0


def test_a_wrong_rate_is_a_condition_and_a_reason(tmp_path: Path) -> None:
    """962.4 Hz where 1000 was stated, at a tenth of both; frames of format A hold no time that could tell."""
    protocol = get_protocol("kvh1750", rate_hz=STATED_HZ)
    samples = empty_samples(round(DURATION_S * TRUE_HZ))
    samples["sequence"] = np.arange(len(samples))
    samples["time"] = (samples["sequence"] + 1) / TRUE_HZ
    samples["dv"][:, 2] = 9.81 / TRUE_HZ
    data, writer = protocol.encode_samples(samples), CaptureWriter(tmp_path / "line.cap")
    for row, time_s in enumerate(samples["time"].tolist()):
        writer.write(data[36 * row : 36 * row + 36], 10.0 + time_s)
    writer.close()
    config = tmp_path / "settings.toml"
    config.write_text(
        f"""
        [link]
        url = "{tmp_path / "tty"}"
        protocol = "kvh1750"
        options = {{ rate_hz = "{STATED_HZ}" }}
        [site]
        latitude_deg = 49.3
        height_m = 80.0
        [reference]
        azimuth_deg = 10.0
        azimuth_sigma_deg = 0.1
        [block]
        gyro_kind = "fibre"
        [store]
        path = "{tmp_path / "inertrim.db"}"
        [time]
        speed = {SPEED}
        """
    )
    controller = Controller(load_settings(config))
    controller.start()
    player = threading.Thread(
        target=play, args=(tmp_path / "line.cap", protocol, tmp_path / "tty"), kwargs={"speed": SPEED}
    )
    player.start()
    try:
        end = time.monotonic() + 60
        while not (against := [one for one in controller.status().facts["reasons"] if one.startswith("sample_rate")]):
            assert time.monotonic() < end, controller.conditions()
            time.sleep(0.05)
        (condition,) = [one for one in controller.conditions()["conditions"] if one["name"] == "sample_rate"]
        assert condition["state"] == "failed"
        assert abs(condition["measured"] - (STATED_HZ / TRUE_HZ - 1)) < 3e-3  # 5 ms of play in a window of 5 s
        assert "frames come off their stated rate by -" in against[0]
        assert not controller.status().facts["fit"]
    finally:
        controller.stop()
        player.join(20)
