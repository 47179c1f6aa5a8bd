"""Places samples of other makers' frames on a line of time: sequence, device time and measured interval.

A device may send a counter of ticks, a clock, or a counter of frames alone. In this order of preference they say when
a sample was taken; the nominal rate never does. Counters that wrap within a breath are helped by the host's clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.differences import differences

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
HOST_LATENCY_S = 0.1
"""By how much host times may be late [s], unless the stream says otherwise."""


@dataclass(slots=True)
class Placed:
    """Sequence (n,), device time [s] (n,) and interval [s] (n,) of samples, and whether the interval is measured."""

    sequence: Ints
    time_s: Floats
    interval_s: Floats
    measured: bool = True


class Ticks:
    """Counts on where a counter wraps.

    Parameters
    ----------
    modulus : number of values of the counter; 1 where the device has none, so that only the host's clock counts.

    Notes
    -----
    The host's clock tells the loss of whole periods. A pause longer than the counter shows is a suspicion: after a loss
    all rows stay late against those before it; rows that a late host delivers are followed by rows in time. Which of
    the two it was shows within two and a half latencies, and there the lost periods are added.
    """

    REMEMBERED_LATENCIES = 20.0
    SETTLING_LATENCIES = 2.5

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._count = 0
        self._total = 0
        self._host_s = np.nan
        self._delays: deque[tuple[float, float]] = deque()
        self._suspicion: _Suspicion | None = None

    @property
    def settled(self) -> bool:
        """Whether it is known that no period was lost."""
        return self._suspicion is None

    def steps(self, counts: Ints, host_s: Floats, same: NDArray[np.bool_], tick_s: float, latency_s: float) -> Ints:
        """Return by how many ticks each row follows the row before; 0 where it is the ``same`` frame again."""
        begun = not np.isnan(self._host_s)
        steps = (differences(counts, self._count) - 1) % self._modulus + 1
        steps[same] = 0
        if not begun:
            steps[0] = 0
        pauses_s = differences(host_s, self._host_s if begun else float(host_s[0])) - steps * tick_s
        settling_s = self.SETTLING_LATENCIES * latency_s
        if self._suspicion is not None:
            self._settle(self._suspicion, 0, steps, host_s, tick_s, settling_s)
        for row in np.flatnonzero(pauses_s > max(0.6 * self._modulus * tick_s, latency_s)).tolist():
            delays = host_s[:row] - (self._total + np.cumsum(steps[:row])) * tick_s
            before_s = min([delay for _, delay in self._delays] + delays.tolist(), default=np.nan)
            self._settle(_Suspicion(float(host_s[row]), before_s), row, steps, host_s, tick_s, settling_s)
        total = self._total + np.cumsum(steps)
        self._remember(host_s - total * tick_s, float(host_s[-1]), self.REMEMBERED_LATENCIES * latency_s)
        self._count, self._total, self._host_s = int(counts[-1]), int(total[-1]), float(host_s[-1])
        return steps

    def _settle(
        self, suspicion: _Suspicion, row: int, steps: Ints, host_s: Floats, tick_s: float, settling_s: float
    ) -> None:
        """Judge a suspicion by the rows from ``row`` on, and add the periods lost; without enough rows keep it."""
        end = int(np.searchsorted(host_s, suspicion.since_s + settling_s, side="right"))
        delays = host_s[row:end] - (self._total + np.cumsum(steps)[row:end]) * tick_s
        suspicion.least_s = min(suspicion.least_s, float(np.min(delays, initial=np.inf)))
        self._suspicion = suspicion if end == len(host_s) else None
        if self._suspicion is None:
            periods = np.floor((suspicion.least_s - suspicion.before_s) / (self._modulus * tick_s) + 0.25)
            steps[row] += self._modulus * int(np.nan_to_num(periods.clip(0), posinf=0))

    def _remember(self, delays: Floats, now_s: float, span_s: float) -> None:
        """Keep the least delay of each batch for a while."""
        least = delays.min()
        if not np.isnan(least):
            self._delays.append((now_s, float(least)))
        while len(self._delays) > 1 and self._delays[0][0] < now_s - span_s:
            self._delays.popleft()


@dataclass(slots=True)
class _Suspicion:
    """A pause since ``since_s``: least delay before it and, so far, behind it [s]."""

    since_s: float
    before_s: float
    least_s: float = np.inf


class FrameStep:
    """Learns what step of a counter or clock is one frame, and counts frames by it.

    Notes
    -----
    Two short steps in a row, or eight longer ones that agree, are a new rate; fewer are a gap.
    """

    ENOUGH = 8
    TOLERANCE = 0.3
    BLOCK = 1024
    """Rows judged at once: where every row is odd, work grows with their square."""

    def __init__(self, step: float | None = None) -> None:
        self.step = step
        self._short_before = False
        self._run = (1, 0)

    def count(self, ticks: Ints) -> Ints:
        """Return by how many frames each row follows the one before; 0 where its step is 0."""
        moving = np.flatnonzero(ticks > 0)
        steps = ticks[moving].astype(np.float64)
        if not len(steps):
            return np.zeros(len(ticks), np.int64)
        if self.step is None:
            self.step = float(np.median(steps))
        frames = np.ones(len(steps), np.int64)
        if len(self._odd(steps)):
            for first in range(0, len(steps), self.BLOCK):
                self._judge_block(steps[first : first + self.BLOCK], frames[first : first + self.BLOCK])
        else:
            self._forget()
            self.step += 0.1 * (float(steps.mean()) - self.step)
        counted = np.zeros(len(ticks), np.int64)
        counted[moving] = frames
        return counted

    def _odd(self, steps: Floats) -> NDArray[np.intp]:
        """Return which steps are not one frame's."""
        assert self.step is not None
        return np.flatnonzero(np.abs(steps / self.step - 1) >= self.TOLERANCE)

    def _forget(self) -> None:
        """Note that a step of one frame came: what was odd before it stands alone."""
        self._short_before, self._run = False, (1, 0)

    def _judge_block(self, steps: Floats, frames: Ints) -> None:
        """Put into ``frames`` what odd steps are; one that is a new rate makes others odd behind it."""
        next_row = 0
        while next_row < len(steps):
            step, first = self.step, next_row
            for row in (self._odd(steps[first:]) + first).tolist():
                if row > next_row:
                    self._forget()
                frames[row] = self._judge(float(steps[row]))
                next_row = row + 1
                if self.step != step:
                    break
            else:
                if next_row < len(steps):
                    self._forget()
                return

    def _judge(self, step: float) -> int:
        """Return by how many frames one row follows the one before; adopt a new rate."""
        assert self.step is not None
        if step < 0.7 * self.step:
            if self._short_before:
                self.step = step
            self._short_before = not self._short_before
            return 1
        self._short_before = False
        frames = max(1, round(step / self.step))
        self._run = (frames, self._run[1] + 1 if self._run[0] == frames else 1)
        if frames > 1 and self._run[1] >= self.ENOUGH:
            self.step, self._run = step, (1, 0)
            return 1
        return frames


@dataclass(slots=True)
class _Ends:
    """Last sequence and time placed, so that the next row knows its interval."""

    sequence: int = -1
    time_s: float = np.nan
    typical_s: float = np.nan

    def intervals(self, sequence: Ints, time_s: Floats) -> Floats:
        """Return the interval of each row [s]: time shared over the frames since the row before."""
        frames = differences(sequence, self.sequence)
        elapsed_s = differences(time_s, self.time_s)
        good = (frames > 0) & (elapsed_s > 0)
        interval_s = np.where(good, elapsed_s / np.where(good, frames, 1), np.nan)
        if good.any():
            self.typical_s = float(np.median(interval_s[good]))
        self.sequence, self.time_s = int(sequence[-1]), float(time_s[-1])
        return np.where(good, interval_s, 0.0 if np.isnan(self.typical_s) else self.typical_s)

    @property
    def measured(self) -> bool:
        """Whether any interval was; before, rates cannot become increments and read 0."""
        return not np.isnan(self.typical_s)


class CounterTimeline:
    """Time by a counter of ticks of known length, as the STIM300 and the HG4930 send it.

    Parameters
    ----------
    modulus, tick_s : values of the counter and length [s] of its step.
    frame_ticks : ticks from frame to frame where known beforehand.
    """

    def __init__(self, modulus: int, tick_s: float, frame_ticks: float | None = None) -> None:
        self._modulus, self._tick_s = modulus, tick_s
        self.frame = FrameStep(frame_ticks)
        self.restart()

    @property
    def interval_known(self) -> bool:
        """Whether a single row could be placed with its interval."""
        return self.frame.step is not None

    def restart(self) -> None:
        """Begin anew at sequence 0 and time 0: the device was switched on."""
        self._ticks = Ticks(self._modulus)
        self._total = 0
        self._ends = _Ends()

    def place(self, counts: Ints, host_s: Floats, same: NDArray[np.bool_], latency_s: float = HOST_LATENCY_S) -> Placed:
        """Place rows by their counter."""
        steps = self._ticks.steps(counts, host_s, same, self._tick_s, latency_s)
        frames = self.frame.count(steps)
        first = self._ends.sequence < 0
        sequence = max(self._ends.sequence, 0) + np.cumsum(frames)
        ticks = self._total + np.cumsum(steps)
        self._total = int(ticks[-1])
        if first and np.isnan(self._ends.typical_s) and self.frame.step is not None:
            self._ends.typical_s = self.frame.step * self._tick_s
        time_s = ticks.astype(np.float64) * self._tick_s
        return Placed(sequence, time_s, self._ends.intervals(sequence, time_s), self._ends.measured)


class ClockTimeline:
    """Time by the device's own clock, with a counter of frames where there is one.

    Parameters
    ----------
    modulus, tick_s : values of the clock, 2⁶² at most, and length [s] of its step.
    counter_modulus : of the counter of frames; None without one.
    """

    def __init__(self, modulus: int, tick_s: float, counter_modulus: int | None = None) -> None:
        self._modulus, self._tick_s, self._counter_modulus = modulus, tick_s, counter_modulus
        self._frame = FrameStep()
        self._stamp: int | None = None
        self._total = 0
        self._count = 0
        self._host_s = np.nan
        self._ends = _Ends()

    @property
    def interval_known(self) -> bool:
        """Whether a single row could be placed with its interval."""
        return self._frame.step is not None

    def place(self, stamps: Ints, counts: Ints | None, host_s: Floats) -> Placed:
        """Place rows by their clock; where it goes back, or on much further than the host's, the device restarted."""
        stamps = stamps % self._modulus
        if self._stamp is None:
            self._stamp = self._total = int(stamps[0])
            first_count = 0 if counts is None else int(counts[0])
            self._count, self._host_s = first_count, float(host_s[0])
        elapsed, restarts = self._elapsed(stamps, host_s)
        frames = self._frames(elapsed, counts)
        if self._ends.sequence < 0:
            frames[0] = 0
        sequence = max(self._ends.sequence, 0) + np.cumsum(frames)
        total = self._total + np.cumsum(elapsed)
        for row in restarts:
            sequence[row:] -= sequence[row]
            total[row:] += stamps[row] - total[row]
        self._stamp, self._total, self._host_s = int(stamps[-1]), int(total[-1]), float(host_s[-1])
        self._count = 0 if counts is None else int(counts[-1])
        if np.isnan(self._ends.typical_s) and self._frame.step is not None:
            self._ends.typical_s = self._frame.step * self._tick_s
        time_s = total.astype(np.float64) * self._tick_s
        return Placed(sequence, time_s, self._ends.intervals(sequence, time_s), self._ends.measured)

    def _elapsed(self, stamps: Ints, host_s: Floats) -> tuple[Ints, list[int]]:
        """Return the ticks since the row before, and the rows at which the clock began anew."""
        assert self._stamp is not None
        elapsed = differences(stamps, self._stamp) % self._modulus
        back = elapsed > self._modulus // 2
        if back.any():
            ahead_s = elapsed * self._tick_s - differences(host_s, self._host_s)
            back &= ahead_s > self._modulus * self._tick_s / 4
            elapsed[back] = 0
        return elapsed, np.flatnonzero(back).tolist()

    def _frames(self, elapsed: Ints, counts: Ints | None) -> Ints:
        """Return by how many frames each row follows the one before."""
        by_clock = self._frame.count(elapsed)
        if counts is None or self._counter_modulus is None:
            return by_clock
        short = (differences(counts, self._count) - 1) % self._counter_modulus + 1
        periods = np.rint((by_clock - short) / self._counter_modulus).clip(0)
        return np.where(elapsed > 0, short + periods.astype(np.int64) * self._counter_modulus, 0)


@dataclass(slots=True)
class _HostFit:
    """Interval of frames by the host's clock: a line through the rows of least delay, one a window."""

    interval_s: float
    measured: bool = False
    points: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=240))
    window: int = -1
    best: tuple[float, int, float] = (np.inf, 0, 0.0)

    WINDOW_LATENCIES = 2.5
    SPAN_LATENCIES = 20.0

    def follow(self, number: Ints, host_s: Floats, latency_s: float) -> None:
        """Take rows by number and host time [s]."""
        known = np.isfinite(host_s)
        windows = np.where(known, np.floor(host_s / (self.WINDOW_LATENCIES * latency_s)), -1).astype(np.int64)
        edges = np.flatnonzero(np.diff(windows)) + 1
        delays = host_s - number * self.interval_s
        opened = self.window
        for low, high in zip([0, *edges.tolist()], [*edges.tolist(), len(windows)], strict=True):
            if windows[low] != self.window:
                self._close()
                self.window = int(windows[low])
            row = low + int(np.argmin(delays[low:high]))
            self.best = min(self.best, (float(delays[row]), int(number[row]), float(host_s[row])))
        if self.window != opened:
            self._fit(self.SPAN_LATENCIES * latency_s)

    def _close(self) -> None:
        if np.isfinite(self.best[0]):
            self.points.append(self.best[1:])
        self.best = (np.inf, 0, 0.0)

    def _fit(self, span_s: float) -> None:
        if len(self.points) < 4 or self.points[-1][1] - self.points[0][1] < span_s:
            return
        number, host_s = np.array(self.points).T
        number, host_s = number - number.mean(), host_s - host_s.mean()
        slope = float(number @ host_s / (number @ number)) if number.any() else 0.0
        if slope > 0:
            self.interval_s, self.measured = slope, True


class HostTimeline:
    """Time of a device that sends none: its frames counted, the interval between them measured by the host's clock.

    Parameters
    ----------
    rate_hz : stands for the rate until it is measured.
    stated : whether the user vouches for that rate, so that a stream without host times can be placed.
    counter_modulus : of the counter of frames; 1 without one.
    """

    def __init__(self, rate_hz: float, stated: bool, counter_modulus: int = 1) -> None:
        self._ticks = Ticks(counter_modulus)
        self._fit = _HostFit(1.0 / rate_hz)
        self._stated = stated
        self._number = 0
        self._time_s = np.nan
        self._first_host_s = np.nan

    def place(self, counts: Ints, host_s: Floats, same: NDArray[np.bool_], latency_s: float = HOST_LATENCY_S) -> Placed:
        """Place rows by their counter and the host's clock."""
        steps = self._ticks.steps(counts, host_s, same, self._fit.interval_s, latency_s)
        number = self._number + np.cumsum(steps)
        if self._ticks.settled:
            self._fit.follow(number, host_s, latency_s)
        if np.isnan(self._time_s):
            self._time_s, self._first_host_s = 0.0, float(host_s[0])
        time_s = self._time_s + np.cumsum(steps).astype(np.float64) * self._fit.interval_s
        self._number, self._time_s = int(number[-1]), float(time_s[-1])
        timeless = self._stated and not float(host_s[-1]) > self._first_host_s
        return Placed(
            number, time_s, np.full(len(number), self._fit.interval_s), measured=self._fit.measured or timeless
        )
