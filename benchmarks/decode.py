"""Frames decoded per second of processor time: checksum and scaling included, on clean and on damaged streams.

Ours from bytes to samples (the replay's path; and the live one, which takes what a device sends between two batches of
a link), each peer on its own encoder's stream, and ``zlib.crc32`` over our bytes, which no decoder that checks them can
beat. One run measures all: compare the ratios.
"""

from __future__ import annotations

import argparse
import importlib
import io
import json
import random
import tempfile
import time
import warnings
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.capture import CaptureWriter, replay
from drivers.clock import HostClock
from drivers.link import BATCH_S
from drivers.protocols import get_protocol
from drivers.protocols.base import Protocol
from drivers.samples import SampleArray, empty_samples
from drivers.stream import StreamDecoder

RATE_HZ = 2000.0
CHUNK_FRAMES = 10
PIECE_BYTES = 2**21
READ_S = 0.001
"""A live line is read this often: what a USB adapter hands on at once, at its best."""
FIFTY = 50
FLIPPED, CUT, GARBAGE = 0.01, 0.002, 0.002
FASTEST_DEVICE_HZ = {"native": 2000.0, "stim300": 2000.0, "kvh1750": 5000.0}
"""Highest sample rate of the device that speaks a protocol."""


@dataclass
class Case:
    """One decoder on one stream: frames it was given, frames it gave, and its best time [s]."""

    name: str
    stream: str
    given: int
    found: int
    seconds: float
    frame_bytes: int

    @property
    def frames_per_s(self) -> float:
        return self.given / self.seconds


def samples_at(count: int) -> SampleArray:
    """Return samples of a block at rest on a shaking floor."""
    rng = np.random.default_rng(0)
    samples = empty_samples(count, 3)
    samples["sequence"] = np.arange(count)
    samples["time"] = np.round((samples["sequence"] + 1) / RATE_HZ, 6)
    samples["dv"] = rng.normal([0.0, 0.0, 9.81 / RATE_HZ], 1e-4, (count, 3))
    samples["dtheta"] = rng.normal(0, 1e-6, (count, 3))
    samples["temperature"], samples["supply"] = 35.0, 28.0
    return samples


def damage(frames: list[bytes]) -> bytes:
    """Flip a bit in 1 % of the frames, cut 0.2 %, put garbage ahead of 0.2 %."""
    rng, out = random.Random(1), []
    for frame in frames:
        if rng.random() < GARBAGE:
            out.append(rng.randbytes(rng.randrange(1, 40)))
        if rng.random() < FLIPPED:
            flipped = bytearray(frame)
            flipped[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
            frame = bytes(flipped)
        if rng.random() < CUT:
            frame = frame[: rng.randrange(1, len(frame))]
        out.append(frame)
    return b"".join(out)


def best(work: Callable[[], int], seconds: float) -> tuple[float, int]:
    """Return the least processor time [s] of one turn of ``work``, repeated for a while, and what it returned."""
    found = work()
    least, began = float("inf"), time.monotonic()
    while time.monotonic() - began < seconds:
        start = time.process_time()
        found = work()
        least = min(least, time.process_time() - start)
    return least, found


def by_stretch(protocol: Protocol, stream: bytes) -> int:
    """Decode as a replay does; return the number of samples."""
    decoder, count, size = StreamDecoder(protocol), 0, 60 * CHUNK_FRAMES
    for start in range(0, len(stream), PIECE_BYTES):
        data = np.frombuffer(stream, np.uint8, min(PIECE_BYTES, len(stream) - start), start)
        ends = np.append(np.arange(size, len(data), size), len(data))
        decoder.feed_stretch(data, ends, (start + ends) / (size / CHUNK_FRAMES * RATE_HZ))
        count += len(decoder.take().samples)
    decoder.finish()
    return count + len(decoder.take().samples)


def live(protocol: Protocol, stream: bytes, frame_bytes: int, rate_hz: float) -> int:
    """Decode as a link does that keeps pace with frames at ``rate_hz``, clock fit included; return the samples' number.

    A link gathers what comes in ``BATCH_S``, so that a batch holds the more the faster they come.
    """
    decoder, clock, count = StreamDecoder(protocol), HostClock(), 0
    decoder.prepare()
    size = frame_bytes * round(READ_S * rate_hz)
    step = size * round(BATCH_S / READ_S)
    for start in range(0, len(stream), step):
        cuts = range(start, min(start + step, len(stream)), size)
        decoder.feed_chunks([((cut + size) / frame_bytes / rate_hz, stream[cut : cut + size]) for cut in cuts])
        batch = decoder.take((start + step) / frame_bytes / rate_hz)
        batch.follow_clock(clock)
        count += len(batch.samples)
    return count


def of_file(protocol: Protocol, path: Path) -> int:
    """Decode a capture file; return the number of samples."""
    return sum(len(batch.samples) for batch in replay(path, protocol))


def ours(name: str, options: dict[str, object], count: int, seconds: float, folder: Path) -> list[Case]:
    """Measure one of our protocols and, over the same bytes, zlib."""
    protocol = get_protocol(name, **options)
    clean = protocol.encode_samples(samples_at(count))
    size = len(clean) // count
    frames = [clean[start : start + size] for start in range(0, len(clean), size)]
    damaged = damage(frames)
    label = f"inertrim {name}"
    cases = []
    for kind, stream in (("clean", clean), ("damaged", damaged)):
        least, found = best(lambda stream=stream: by_stretch(protocol, stream), seconds)  # type: ignore[misc]
        cases.append(Case(f"{label}, replay", kind, count, found, least, size))
    path = folder / f"{name}.cap"
    writer = CaptureWriter(path)
    for start in range(0, len(clean), size * CHUNK_FRAMES):
        writer.write(clean[start : start + size * CHUNK_FRAMES], start / size / RATE_HZ)
    writer.close()
    least, found = best(lambda: of_file(protocol, path), seconds)
    cases.append(Case(f"{label}, replay from disk", "clean", count, found, least, size))
    some = min(count, 20_000)
    for kind, stream in (("clean", clean), ("damaged", damaged)):
        rate_hz = FIFTY * FASTEST_DEVICE_HZ[name]
        least, found = best(lambda stream=stream, rate_hz=rate_hz: live(protocol, stream, size, rate_hz), seconds)  # type: ignore[misc]
        cases.append(Case(f"{label}, live at {FIFTY} devices' rate", kind, count, found, least, size))
    for kind, stream in (("clean", clean[: size * some]), ("damaged", damage(frames[:some]))):
        least, found = best(lambda stream=stream: live(protocol, stream, size, FASTEST_DEVICE_HZ[name]), seconds)  # type: ignore[misc]
        cases.append(Case(f"{label}, live at the device's rate", kind, some, found, least, size))
    least, _ = best(lambda: zlib.crc32(clean), seconds)
    cases.append(Case(f"zlib.crc32 over the {name} bytes", "clean", count, count, least, size))
    return cases


def pyubx2(count: int) -> tuple[list[bytes], Callable[[bytes], int]]:
    """ESF-INS: three rates, three accelerations."""
    package = importlib.import_module("pyubx2")
    rng = random.Random(2)
    frames = [
        package.UBXMessage(
            b"\x10", b"\x15", 0, payload=bytes([1, 0, 0x3F, 0]) + bytes(4) + rng.randbytes(28)
        ).serialize()
        for _ in range(count)
    ]

    def decode(stream: bytes) -> int:
        reader = package.UBXReader(io.BytesIO(stream), quitonerror=0)
        return sum(parsed is not None for _, parsed in reader)

    return frames, decode


def pymavlink(count: int) -> tuple[list[bytes], Callable[[bytes], int]]:
    """HIGHRES_IMU of MAVLink 2."""
    dialect = importlib.import_module("pymavlink.dialects.v20.common")
    sender, rng = dialect.MAVLink(None), random.Random(3)
    frames = []
    for number in range(count):
        values = [rng.uniform(-1, 1) for _ in range(13)]
        message = dialect.MAVLink_highres_imu_message(number * 500, *values, 0x3F, 0)
        frames.append(bytes(message.pack(sender)))
        sender.seq = (sender.seq + 1) % 256

    def decode(stream: bytes) -> int:
        receiver = dialect.MAVLink(None)
        receiver.robust_parsing = True
        messages = receiver.parse_buffer(stream) or []
        return sum(message.get_type() == "HIGHRES_IMU" for message in messages)

    return frames, decode


def construct(count: int) -> tuple[list[bytes], Callable[[bytes], int]]:
    """Our native frame as a compiled construct, found by its sync."""
    c = importlib.import_module("construct")
    sync = bytes.fromhex("c749549e")
    body = c.Struct(
        "sync" / c.Const(sync), "version" / c.Int8ul, "type" / c.Int8ul, "length" / c.Int16ul,
        "sequence" / c.Int32ul, "time_us" / c.Int64ul, "dv" / c.Array(3, c.Int32sl), "dtheta" / c.Array(3, c.Int32sl),
        "temperature" / c.Array(3, c.Int16sl), "supply_mv" / c.Int16ul, "status" / c.Int32ul, "crc" / c.Int32ul,
    ).compile()  # fmt: skip
    values: dict[str, Any] = {"version": 1, "type": 1, "length": 60, "temperature": [0, 0, 0]}
    values |= {"supply_mv": 28000, "status": 0, "crc": 0}
    frames = []
    for number in range(count):
        whole = body.build(
            {"sequence": number, "time_us": number * 500, "dv": [1, 2, 3], "dtheta": [4, 5, 6], **values}
        )
        frames.append(whole[:-4] + zlib.crc32(whole[:-4]).to_bytes(4, "little"))

    def decode(stream: bytes) -> int:
        found, place = 0, 0
        while (place := stream.find(sync, place)) >= 0 and place + 60 <= len(stream):
            frame = body.parse(stream[place : place + 60])
            if zlib.crc32(stream[place : place + 56]) != frame.crc:
                place += 1
                continue
            _ = [step * 2.0**-24 for step in frame.dv], [step * 2.0**-30 for step in frame.dtheta]
            found, place = found + 1, place + 60
        return found

    return frames, decode


def novatel_edie(count: int) -> tuple[list[bytes], Callable[[bytes], int]]:
    """RAWIMUSX, a real frame again and again; framed, checked and decoded by its C++ core."""
    oem = importlib.import_module("novatel_edie.oem")
    frame = bytes.fromhex(
        "aa441328b6059c0678b9e21c000b9c060b9755a832941d4103158000ebd09102a687f3ff38eafcff66b7fcff1c5fffff59d9ffff475fafba"
    )

    def decode(stream: bytes) -> int:
        parser, found, place = oem.Parser(), 0, 0
        parser.return_unknown_bytes = False
        while True:
            written = parser.write(stream[place : place + parser.available_space])
            place += written
            found += sum(hasattr(message, "accel_x") for message in parser)
            if not written:
                return found

    return [frame] * count, decode


PEERS = {"pyubx2": pyubx2, "pymavlink": pymavlink, "construct": construct, "novatel_edie": novatel_edie}


def peer(name: str, count: int, seconds: float) -> list[Case]:
    """Measure one peer; nothing when it is not installed."""
    try:
        frames, decode = PEERS[name](count)
    except ModuleNotFoundError:
        return []
    cases = []
    for kind, stream in (("clean", b"".join(frames)), ("damaged", damage(frames))):
        least, found = best(lambda stream=stream: decode(stream), seconds)  # type: ignore[misc]
        cases.append(Case(name, kind, count, found, least, len(frames[0])))
    return cases


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.decode", description=__doc__)
    parser.add_argument("--frames", type=int, default=200_000, help="of ours; peers get a hundredth")
    parser.add_argument("--seconds", type=float, default=1.5, help="how long each is repeated")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)
    with tempfile.TemporaryDirectory() as folder:
        cases = ours("native", {}, arguments.frames, arguments.seconds, Path(folder))
        cases += ours("stim300", {"crlf": "false"}, arguments.frames, arguments.seconds, Path(folder))
        cases += ours("kvh1750", {}, arguments.frames, arguments.seconds, Path(folder))
    absent = []
    for name in PEERS:
        measured = peer(name, max(1000, arguments.frames // 100), arguments.seconds)
        cases += measured
        if not measured:
            absent.append(name)
    figures = {"cases": [asdict(case) for case in cases], "absent": absent, **ratios(cases)}
    figures["table"] = table(cases, absent)
    print(json.dumps({key: value for key, value in figures.items() if key not in ("cases", "table")}, indent=2))
    for row in figures["table"]["rows"]:
        print("  ".join(f"{cell:<44}" if place == 0 else f"{cell:>14}" for place, cell in enumerate(row)))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


def ratios(cases: list[Case]) -> dict[str, Any]:
    """Return what the aims are about."""
    speed = {(case.name, case.stream): case.frames_per_s for case in cases}
    fastest_peer = max((value for (name, _), value in speed.items() if name in PEERS), default=float("nan"))
    found: dict[str, Any] = {}
    for name, rate_hz in FASTEST_DEVICE_HZ.items():
        replayed = speed[f"inertrim {name}, replay", "clean"]
        found[name] = {
            "replay_frames_per_s": replayed,
            "times_the_fastest_peer": replayed / fastest_peer,
            "crc32_limit_over_it": speed[f"zlib.crc32 over the {name} bytes", "clean"] / replayed,
            "live_times_the_device": speed[f"inertrim {name}, live at {FIFTY} devices' rate", "clean"] / rate_hz,
            "core_for_one_device": rate_hz / speed[f"inertrim {name}, live at the device's rate", "clean"],
        }
    return found


def table(cases: list[Case], absent: list[str]) -> dict[str, Any]:
    """Return the README's table."""
    rows = []
    for case in cases:
        if case.stream == "damaged":
            continue
        worse = next((one for one in cases if (one.name, one.stream) == (case.name, "damaged")), None)
        spoiled = f"{worse.frames_per_s:,.0f}" if worse else ""
        megabytes = case.frames_per_s * case.frame_bytes / 1e6
        rows.append([case.name, f"{case.frames_per_s:,.0f}", spoiled, f"{megabytes:,.0f}"])
    rows += [[name, "not installed", "", ""] for name in absent]
    return {"header": ["decoder", "frames/s", "damaged stream", "MB/s"], "rows": rows}


if __name__ == "__main__":
    main()
