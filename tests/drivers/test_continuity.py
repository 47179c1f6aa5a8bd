"""Gaps, repeats and restarts, each told from the others."""

from __future__ import annotations

import numpy as np
from driver_bench import counting_samples

from drivers.continuity import Continuity, Gap
from drivers.samples import SampleArray


def follow(continuity: Continuity, samples: SampleArray, late_s: float = 0.0, reopened: tuple[int, ...] = ()):  # type: ignore[no-untyped-def]
    return continuity.follow(samples, samples["time"] + late_s, reopened)


def test_an_unbroken_stream_has_no_marks() -> None:
    continuity = Continuity()
    for first in (0, 50):
        marks = follow(continuity, counting_samples(50, first))
        assert (len(marks.keep), marks.gaps, marks.restarts, marks.duplicates) == (50, [], [], 0)


def test_the_wrap_of_the_counter_is_no_gap() -> None:
    samples = counting_samples(4)
    samples["sequence"] = [2**32 - 2, 2**32 - 1, 0, 1]
    marks = follow(Continuity(), samples)
    assert (marks.gaps, marks.restarts) == ([], [])


def test_missing_frames_are_counted_where_they_are_missing_also_between_batches() -> None:
    samples = counting_samples(20)
    continuity = Continuity()
    first = follow(continuity, np.concatenate([samples[:3], samples[5:8]]))
    assert first.gaps == [Gap(3, 2, samples["time"][5] - samples["time"][2])]
    assert follow(continuity, samples[11:]).gaps == [Gap(0, 3, samples["time"][11] - samples["time"][7])]


def test_a_repeated_frame_is_dropped() -> None:
    samples = counting_samples(5)
    marks = follow(Continuity(), samples[[0, 1, 1, 2, 2, 3]])
    assert marks.keep.tolist() == [0, 1, 3, 5]
    assert marks.duplicates == 2
    assert marks.gaps == []


def test_a_block_that_counts_anew_is_told_even_early_in_its_life() -> None:
    samples = counting_samples(60)
    marks = follow(Continuity(), np.concatenate([samples[:50], samples[2:4]]))
    assert marks.restarts == [50]
    assert marks.gaps == []


def test_a_device_time_that_went_back_is_a_restart_though_the_counter_went_on() -> None:
    samples = counting_samples(60)
    samples["time"][50:] -= 0.4
    marks = follow(Continuity(), samples)
    assert (marks.restarts, marks.gaps) == ([50], [])


def test_a_restart_hidden_by_an_unplugged_line_is_told_by_host_time() -> None:
    continuity = Continuity(delay_tolerance_s=0.5)
    follow(continuity, counting_samples(10))
    later = counting_samples(5, first=500)  # 4.9 s on, by its own count; 14.9 s on by ours
    assert follow(continuity, later, late_s=10.0, reopened=(0,)).restarts == [0]


def test_a_line_unplugged_while_the_block_ran_on_is_a_gap() -> None:
    continuity = Continuity(delay_tolerance_s=0.5)
    follow(continuity, counting_samples(10))
    marks = follow(continuity, counting_samples(5, first=500), late_s=0.3, reopened=(0,))
    assert marks.restarts == []
    assert [gap.frames for gap in marks.gaps] == [490]


def test_a_host_that_was_late_and_lost_frames_meanwhile_reports_no_restart() -> None:
    continuity = Continuity(delay_tolerance_s=0.5)
    follow(continuity, counting_samples(10))
    marks = follow(continuity, counting_samples(5, first=100), late_s=10.0)
    assert (len(marks.gaps), marks.restarts) == (1, [])
