"""``convert``, ``replay``, ``capture``, ``detect``: files of a line through the command line, and onto a line again."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from forked import Program, inertrim

from drivers.capture import CaptureWriter, RecordKind, read_capture
from drivers.link import SerialLink
from drivers.protocols import get_protocol
from drivers.recording import read_recording
from drivers.samples import SampleArray, empty_samples
from drivers.timebase import Timebase
from service import cli
from service.playback import play

NATIVE = get_protocol("native")
SKEW = 80e-6


def samples_at(rate_hz: float, count: int, first: int = 0) -> SampleArray:
    rng = np.random.default_rng(1)
    samples = empty_samples(count, 3)
    samples["sequence"] = np.arange(first, first + count)
    samples["time"] = np.round((samples["sequence"] + 1) / rate_hz, 6)
    samples["dv"] = rng.integers(-(2**18), 2**18, (count, 3)) * 2.0**-24
    samples["dtheta"] = rng.integers(-(2**12), 2**12, (count, 3)) * 2.0**-30
    samples["temperature"] = 30.25
    samples["supply"] = 28.0
    return samples


def capture_of(path: Path, samples: SampleArray, start_s: float = 50.0) -> Path:
    """Write a capture as a line delivers it, delays and a slow block's clock included."""
    writer, rng = CaptureWriter(path), np.random.default_rng(2)
    writer.write(b"{}", start_s, RecordKind.OPENED)
    data, size = NATIVE.encode_samples(samples), 60
    for row in range(0, len(samples), 5):
        last_s = float(samples["time"][min(row + 4, len(samples) - 1)])
        writer.write(data[row * size : (row + 5) * size], start_s + last_s * (1 + SKEW) + rng.exponential(1e-3))
    writer.close()
    return path


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["inertrim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        written = capsys.readouterr()
        return int(left.value.code or 0), written.out, written.err

    return call


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".mcap"])
def test_converting_twice_gives_the_same_bytes(run: Run, tmp_path: Path, suffix: str) -> None:
    if suffix == ".mcap":
        pytest.importorskip("mcap")
    path = capture_of(tmp_path / "line.cap", samples_at(200.0, 2000))
    for name in ("a", "b"):
        code, out, err = run("convert", path, "--out", tmp_path / f"{name}{suffix}")
        assert (code, err) == (0, "")
        assert "2000 samples" in out
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_converted_recording_holds_every_number(run: Run, tmp_path: Path, suffix: str) -> None:
    samples = samples_at(200.0, 500)
    assert run("convert", capture_of(tmp_path / "line.cap", samples), "--out", tmp_path / f"a{suffix}")[0] == 0
    recording = read_recording(tmp_path / f"a{suffix}")
    assert recording.samples.tobytes() == samples.tobytes()
    assert recording.meta.block.sample_rate_hz == 200.0


def test_of_two_stretches_the_longer_is_written(run: Run, tmp_path: Path) -> None:
    first, second = samples_at(200.0, 300), samples_at(200.0, 400)
    capture_of(tmp_path / "line.cap", first)
    capture_of(tmp_path / "line.cap", second, start_s=60.0)
    code, out, _ = run("convert", tmp_path / "line.cap", "--out", tmp_path / "a.parquet")
    assert code == 0
    assert "400 samples" in out
    assert "2 stretches" in out
    assert read_recording(tmp_path / "a.parquet").samples.tobytes() == second.tobytes()


def test_what_bytes_cannot_tell_comes_by_option(run: Run, tmp_path: Path) -> None:
    """The range scales, the counter's steps give the rate."""
    samples = samples_at(500.0, 400)
    (tmp_path / "line.bin").write_bytes(get_protocol("stim300", accel_range_g="30").encode_samples(samples))
    found = {}
    for range_g in ("10", "30"):
        out = tmp_path / f"{range_g}.parquet"
        options = ("--protocol", "stim300", "--option", f"accel_range_g={range_g}")
        assert run("convert", tmp_path / "line.bin", *options, "--out", out)[0] == 0
        found[range_g] = read_recording(out)
    assert found["30"].meta.block.sample_rate_hz == 500.0
    assert found["30"].samples["dv"][5:] == pytest.approx(samples["dv"][5:], abs=9.80665 / 2**18 / 500)
    assert found["10"].samples["dv"][5:] * 2 == pytest.approx(found["30"].samples["dv"][5:])


def test_the_real_power_up_keeps_its_start_up(run: Run, shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "captures" / "stim300_0x93_powerup_2000Hz_30g.hex"
    options = ("--protocol", "stim300", "--option", "accel_range_g=30")
    assert run("convert", path, *options, "--out", tmp_path / "a.parquet")[0] == 0
    samples = read_recording(tmp_path / "a.parquet").samples
    assert len(samples) == 8392
    assert np.count_nonzero(samples["status"] & 1) == 562


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--option", "accel_range_g"], "NAME=VALUE"),
        (["--option", "volume=11"], "no option volume"),
        (["--protocol", "morse"], "no protocol named 'morse'"),
        (["--out", "a.xlsx"], "does not say what to write"),
        (["--out", "nowhere/a.csv"], "does not exist"),
    ],
)
def test_wrong_input_is_refused_in_a_line(run: Run, tmp_path: Path, arguments: list[str], words: str) -> None:
    path = capture_of(tmp_path / "line.cap", samples_at(200.0, 20))
    given = arguments if "--out" in arguments else [*arguments, "--out", str(tmp_path / "a.csv")]
    code, _, err = run("convert", path, *given)
    assert code == 2
    assert err.count("\n") == 1
    assert words in err


def test_bytes_of_another_device_are_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "line.bin").write_bytes(bytes(5000))
    code, _, err = run("convert", tmp_path / "line.bin", "--out", tmp_path / "a.csv")
    assert code == 2
    assert "line.bin: no whole record of a capture, no frame of protocol native in 5000 bytes" in err
    assert not (tmp_path / "a.csv").exists()


def test_frames_that_say_nothing_are_told_from_bytes_that_are_none(run: Run, shared_data: Path, tmp_path: Path) -> None:
    """NovAtel's are for the splitter alone: they are counted, and there is no sample to convert."""
    path = shared_data / "captures" / "novatel_rawimusx.hex"
    assert run("replay", path, "--protocol", "novatel", "--json", tmp_path / "facts.json")[0] == 1
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert (facts["frames"], facts["samples"], facts["bytes_discarded"]) == (2, 0, 0)
    code, _, err = run("convert", path, "--protocol", "novatel", "--out", tmp_path / "a.csv")
    assert code == 2
    assert "holds no samples to write" in err


def test_replay_tells_the_skew_of_the_blocks_clock(run: Run, tmp_path: Path) -> None:
    path = capture_of(tmp_path / "line.cap", samples_at(200.0, 8000))
    assert run("replay", path, "--json", tmp_path / "facts.json")[0] == 0
    facts = json.loads((tmp_path / "facts.json").read_text())
    skew_ppm, sigma_ppm = facts["clock_skew_ppm"]
    assert 0 < sigma_ppm < 2
    assert abs(skew_ppm - SKEW * 1e6) < 5 * sigma_ppm
    assert facts["clock_offset_s"][0] == pytest.approx(50.0, abs=1e-3)


@contextmanager
def playing(file: Path, protocol: str, path: Path, speed: float) -> Iterator[list[int]]:
    """Play a file in a thread; the list gets the count of bytes at the end."""
    done: list[int] = []
    options = {"accel_range_g": "30"} if protocol == "stim300" else {}
    spoken = get_protocol(protocol, **options)
    thread = threading.Thread(target=lambda: done.append(play(file, spoken, path, speed=speed)), daemon=True)
    thread.start()
    end = time.monotonic() + 10
    while not path.is_symlink():
        assert time.monotonic() < end
        time.sleep(0.005)
    yield done
    thread.join(20)
    assert not thread.is_alive()


@pytest.mark.parametrize("kind", ["capture", "bare bytes"])
def test_a_file_is_played_as_it_came_and_nothing_is_lost(tmp_path: Path, kind: str) -> None:
    """Three seconds at speed 2; a link at that speed reads every sample, at the rate that it once had."""
    samples = samples_at(500.0, 1500)
    file = capture_of(tmp_path / "line.cap", samples)
    if kind == "bare bytes":
        file.write_bytes(NATIVE.encode_samples(samples))
    found = []
    with playing(file, "native", tmp_path / "tty", 2.0) as done:
        link = SerialLink(str(tmp_path / "tty"), NATIVE, timebase=Timebase(2.0))
        with link:
            end = time.monotonic() + 20
            while sum(len(rows) for rows, _ in found) < 1500 and time.monotonic() < end:
                batch = link.read(0.1)
                if batch is not None:
                    found.append((batch.samples, batch.host_time_s))
            time.sleep(0.05)
    assert np.concatenate([rows for rows, _ in found]).tobytes() == samples.tobytes()
    host_s = np.concatenate([times for _, times in found])
    assert host_s[-1] - host_s[0] == pytest.approx(3.0, abs=1.0)
    assert done == [1500 * 60]


def test_capture_stores_in_compressed_parts_and_converts(run: Run, tmp_path: Path) -> None:
    samples = samples_at(500.0, 1000)
    file = capture_of(tmp_path / "line.cap", samples)
    with playing(file, "native", tmp_path / "tty", 4.0):
        arguments = ("--link", tmp_path / "tty", "--duration", "6", "--speed", "4", "--part-mb", "0.02")
        code, out, err = run("capture", tmp_path / "new.cap", *arguments, "--out", tmp_path / "a.parquet")
    assert code == 0, err
    assert "1000 samples heard" in out
    assert len(list(tmp_path.glob("new*.cap.gz"))) > 2
    assert b"".join(r.data for r in read_capture(tmp_path / "new.cap") if r.kind == 0) == NATIVE.encode_samples(samples)
    assert read_recording(tmp_path / "a.parquet").samples.tobytes() == samples.tobytes()


def test_detect_names_what_is_on_the_line(tmp_path: Path) -> None:
    """Both ends in processes of their own: the simulator in a STIM300's place, and whoever wonders what that is."""
    pty = tmp_path / "tty"
    options = ["--protocol", "stim300", "--option", "accel_range_g=30"]
    device = Program("simulate", *options, "--pty", pty)
    try:
        end = time.monotonic() + 60
        while not pty.exists():
            assert time.monotonic() < end
            time.sleep(0.02)
        assert inertrim("detect", pty, "--json", tmp_path / "a.json", "--listen", "3").returncode == 0
    finally:
        device.terminate()
        device.wait(20)
    best = json.loads((tmp_path / "a.json").read_text())[0]
    assert best["protocol"] == "stim300"
    assert best["confidence"] > 0.9


def test_detect_says_which_port_is_not_there(run: Run, tmp_path: Path) -> None:
    code, _, err = run("detect", tmp_path / "absent")
    assert code == 2
    assert "absent" in err
    assert err.count("\n") == 1
