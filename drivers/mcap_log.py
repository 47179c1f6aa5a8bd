"""Samples and messages as an MCAP file with JSON-schema channels, which Foxglove opens without any help.

Channels: ``/imu`` (one message a sample), ``/block`` (what the block said of itself), ``/line`` (gaps).
"""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from drivers.continuity import Gap
from drivers.messages import Received
from drivers.samples import SampleArray, Status, intervals_s

_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
SCHEMAS: dict[str, dict[str, Any]] = {
    "/imu": {
        "title": "inertrim.Sample",
        "description": "One frame: increments over its interval, and the rates they make.",
        "properties": {
            "time_s": _NUMBER,
            "sequence": {"type": "integer"},
            "dv_mps": _VECTOR,
            "dtheta_rad": _VECTOR,
            "accel_mps2": _VECTOR,
            "gyro_radps": _VECTOR,
            "temperature_c": {"type": "array", "items": {"type": ["number", "null"]}},
            "supply_v": {"type": ["number", "null"]},
            "status": {"type": "integer"},
            "conditions": {"type": "array", "items": _TEXT},
        },
    },
    "/block": {
        "title": "inertrim.Message",
        "description": "What the block said of itself.",
        "properties": {"kind": _TEXT, "time_s": _NUMBER, "content": {"type": "object"}},
    },
    "/line": {
        "title": "inertrim.Gap",
        "description": "Frames missing ahead of the sample with this sequence number.",
        "properties": {"sequence": {"type": "integer"}, "frames": {"type": "integer"}, "duration_s": _NUMBER},
    },
}


class McapError(RuntimeError):
    """An MCAP file cannot be written: why, and what to do."""


def write_mcap(
    path: Path,
    samples: SampleArray,
    host_time_s: np.ndarray[Any, np.dtype[np.float64]],
    messages: Iterable[Received] = (),
    gaps: Iterable[Gap] = (),
) -> None:
    """Write an MCAP file.

    Parameters
    ----------
    samples : at least two, time and sequence increasing.
    host_time_s : (n,) when each came; where no time passes, the device's time dates the log.
    messages : of the block, dated by the host as well.
    gaps : before rows of ``samples``.

    Raises
    ------
    McapError
        The package ``mcap`` is not installed.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        raise McapError("MCAP files need the package mcap. Install inertrim[mcap].") from None
    timeless = not host_time_s[-1] > host_time_s[0]
    log_s = samples["time"] if timeless else host_time_s
    spoken = [(float(log_s[0]) if timeless else one.host_time_s, "/block", _message(one)) for one in messages]
    missed = [(float(log_s[gap.index]), "/line", _gap(gap, samples)) for gap in gaps]
    sampled = ((time_s, "/imu", row) for time_s, row in zip(log_s.tolist(), _rows(samples), strict=True))
    origin_s = min(0.0, float(log_s[0]), *(time_s for time_s, _, _ in spoken))  # a log's times are not negative
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="inertrim")
        channels = {topic: _channel(writer, topic) for topic in SCHEMAS}
        for time_s, topic, content in heapq.merge(spoken, missed, sampled, key=lambda entry: entry[0]):
            time_ns = round((time_s - origin_s) * 1e9)
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels[topic], log_time=time_ns, publish_time=time_ns, data=data)
        writer.finish()


def _channel(writer: Any, topic: str) -> int:
    """Register a topic with its schema."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "type": "object", **SCHEMAS[topic]}
    number = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
    channel: int = writer.register_channel(topic, "json", number)
    return channel


def _rows(samples: SampleArray) -> Iterable[dict[str, Any]]:
    """Yield each sample as plain data."""
    interval_s = intervals_s(samples)[:, None]
    vectors = {
        "dv_mps": samples["dv"],
        "dtheta_rad": samples["dtheta"],
        "accel_mps2": samples["dv"] / interval_s,
        "gyro_radps": samples["dtheta"] / interval_s,
    }
    columns = {name: values.tolist() for name, values in vectors.items()}
    temperatures = [[_known(value) for value in row] for row in samples["temperature"].tolist()]
    rows = zip(samples["time"].tolist(), samples["sequence"].tolist(), samples["status"].tolist(), strict=True)
    for index, (time_s, sequence, status) in enumerate(rows):
        yield {
            "time_s": time_s,
            "sequence": sequence,
            **{name: dict(zip("xyz", values[index], strict=True)) for name, values in columns.items()},
            "temperature_c": temperatures[index],
            "supply_v": _known(float(samples["supply"][index])),
            "status": status,
            "conditions": [str(flag.name) for flag in Status if flag & status],
        }


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value


def _gap(gap: Gap, samples: SampleArray) -> dict[str, Any]:
    sequence = int(samples["sequence"][gap.index])
    return {"sequence": sequence, "frames": gap.frames, "duration_s": gap.duration_s}


def _message(received: Received) -> dict[str, Any]:
    kind = type(received.message).__name__
    return {"kind": kind, "time_s": received.time_s, "content": _plain(asdict(received.message))}


def _plain(content: Any) -> Any:
    """Return content with null for numbers that are none."""
    if isinstance(content, dict):
        return {name: _plain(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
