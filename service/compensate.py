"""Recording → Result: the one path that the live service and the command line both take, bit for bit the same.

No wall clock, no randomness and no file name enters a number. The sequencer hands over the run's recording with the
windows it used; so does anybody later who reads that recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from drivers.recording import Recording
from inertial.alignment import Alignment, coarse_alignment
from inertial.attitude import roll_pitch_heading
from inertial.compensation import ChainResult, paper_chain, paper_stage
from inertial.documents import (
    BlockModel,
    Calibration,
    Combination,
    Noise,
    Result,
    Sigma,
    StageTerms,
    WindowRecord,
    parse_document,
)
from inertial.error_model import Terms
from inertial.increments import Increments
from inertial.verification import Verification, verify
from service.block_noise import audible, noise_of_span
from service.errors import RefusedInput
from service.physical import Physical
from service.still_spans import described_rest, movement, noise_to_judge_by, still_spans
from service.verdict import SIGNIFICANT_SIGMA, Window, judge
from service.windows import SHORTEST_S, STAGES, automatic_windows, recorded_windows

METHODS = ("paper",)
ORDER = ["f_x", "f_y", "f_z", "g_x", "g_y", "g_z"]


def compensate(
    recording: Recording,
    *,
    method: str = "paper",
    start_s: float | None = None,
    end_s: float | None = None,
    calibration: Calibration | None = None,
    model: BlockModel | None = None,
) -> Result:
    """Estimate the terms of (8), (9) from a recording at rest, with their covariance, and verify them on fresh data.

    Parameters
    ----------
    recording
        With site and reference. Its ``[[window]]`` entries are used as they are; without them, or where a span is asked
        for, windows are chosen: the first span that is still, 30 s to align, 3 × 60 s, 60 s to verify.
    method
        ``"paper"``: three chained stages.
    start_s, end_s
        Device time to keep to [s].
    calibration
        In place of the recording's own; without either the model's, without any the ideal block.
    model
        In place of the recording's own. Its noise is used instead of what the data show, unless it is left free.

    Raises
    ------
    RefusedInput, RecordingError, DocumentError
        The recording cannot be analysed at all. A block that moved is no error but a result that is not fit.
    """
    if method not in METHODS:
        raise RefusedInput("method", f"{method!r} is not known.", f"Known: {', '.join(METHODS)}.")
    model = model or _model_of(recording)
    physical = Physical.of(recording, calibration, model)
    windows = _windows(physical, start_s, end_s)
    spans = {window.kind: physical.span(window.start_s, window.end_s) for window in windows}
    noise, noise_source = _noise(physical, windows, model)
    try:
        alignment = _align(physical, windows[0], spans["align"], noise)
        chain = paper_chain([spans[kind] for kind in STAGES], alignment, physical.site, physical.coefficients, noise)
        verification = verify(spans["verify"], chain, physical.site, physical.coefficients, noise)
    except ValueError as error:
        raise RefusedInput(physical.name, f"{error}.", "Check its calibration, units and site.") from None
    quiet = noise_to_judge_by(physical, windows[0].start_s, windows[-1].end_s)
    checked: dict[str, Window] = {
        window.kind: _checked(physical, window, spans[window.kind], quiet) for window in windows
    }
    judgement = judge(checked, chain, verification)
    return Result(
        software=f"inertrim {version('inertrim')}",
        method="paper",
        state="READY" if judgement.fit else "FAULT",
        verdict=judgement.verdict,
        fit=judgement.fit,
        reasons=judgement.reasons,
        windows=windows,
        terms=_stage_terms(chain),
        sigma=Sigma(f_mps2=chain.sigma[:3], g_radps=chain.sigma[3:]),
        order=ORDER,
        covariance=_covariance(chain),
        unobservable=_unobservable(chain, recording),
        noise=noise,
        reference=_reference_facts(physical, noise_source),
        site=_site_facts(physical),
        alignment=_alignment_facts(alignment),
        verification=_verification_facts(verification),
        conditions=_condition_facts(physical, windows, checked),
        block=_block_facts(physical),
        inputs={**recording.inputs(), **_document_inputs(calibration, model, recording)},
    )


def partial(recording: Recording, windows: Sequence[WindowRecord], *, method: str = "paper") -> dict[str, StageTerms]:
    """Return the terms after each stage whose window is given, for progress while a run goes on.

    Parameters
    ----------
    windows
        ``align`` and, in order, the stages there are so far. The numbers are those of the final result.
    """
    del method
    physical = Physical.of(recording, model=_model_of(recording))
    by_kind = {window.kind: window for window in windows}
    first = by_kind["align"]
    alignment = _align(physical, first, physical.span(first.start_s, first.end_s), Noise())
    terms = Terms.zero()
    found: dict[str, StageTerms] = {}
    for kind in STAGES:
        if kind in by_kind:
            span = physical.span(by_kind[kind].start_s, by_kind[kind].end_s)
            terms = paper_stage(span, alignment, physical.site, physical.coefficients, terms).terms
            found[kind] = _document(terms)
    return found


def noise_at_rest(recording: Recording) -> Noise:
    """Return the noise of a block from the longest span of its recording at rest."""
    physical = Physical.of(recording)
    spans = still_spans(physical)
    if not spans:
        raise RefusedInput(physical.name, "it is at rest nowhere.", "Give a recording of the block standing still.")
    longest = max(spans, key=lambda span: span[1] - span[0])
    return noise_of_span(physical.span(*longest), physical.name)


def _model_of(recording: Recording) -> BlockModel | None:
    path = recording.model_path
    return None if path is None else parse_document(BlockModel, path.read_bytes(), str(path))


def _windows(physical: Physical, start_s: float | None, end_s: float | None) -> list[WindowRecord]:
    """Return the windows to use: the recording's own, else chosen where the block stands still.

    Where it stands still for too short, they are laid where its description says that it rests: the check of each
    window then says how it moved.
    """
    recorded = physical.recording.meta.window
    if recorded and start_s is None and end_s is None:
        windows = [WindowRecord(kind=w.kind, start_s=w.start_s, end_s=w.end_s) for w in recorded]
        return recorded_windows(windows, str(physical.recording.meta_path))
    low = max(physical.start_s, -math.inf if start_s is None else start_s)
    high = min(physical.end_s, math.inf if end_s is None else end_s)
    still = still_spans(physical, low, high)
    if any(end - begin >= SHORTEST_S for begin, end in still):
        return automatic_windows(still, physical.name)
    return automatic_windows(described_rest(physical, low, high), physical.name)


def _noise(physical: Physical, windows: Sequence[WindowRecord], model: BlockModel | None) -> tuple[Noise, str]:
    """Return the noise that the covariance is made with, and where it is from."""
    if model is not None and not model.noise.free and model.noise != Noise():
        return audible(model.noise), "block model"
    longest = max(_contiguous(windows), key=lambda span: span[1] - span[0])
    return noise_of_span(physical.span(*longest), physical.name), "these data"


def _contiguous(windows: Sequence[WindowRecord]) -> list[tuple[float, float]]:
    """Return the spans that windows following one another without a pause make."""
    spans = [(windows[0].start_s, windows[0].end_s)]
    for window in windows[1:]:
        if window.start_s == spans[-1][1]:
            spans[-1] = (spans[-1][0], window.end_s)
        else:
            spans.append((window.start_s, window.end_s))
    return spans


def _align(physical: Physical, window: WindowRecord, span: Increments, noise: Noise) -> Alignment:
    reference = physical.reference_at(window.start_s)
    return coarse_alignment(span, physical.coefficients, physical.site, reference, noise)


def _checked(physical: Physical, window: WindowRecord, span: Increments, quiet: Noise) -> Window:
    samples = physical.recording.samples[physical.rows(window.start_s, window.end_s)]
    return Window(span, samples, movement(physical, quiet, window.start_s, window.end_s))


def _document(terms: Terms) -> StageTerms:
    return StageTerms(f_mps2=terms.f_mps2.tolist(), g_radps=terms.g_radps.tolist())


def _stage_terms(chain: ChainResult) -> dict[Any, StageTerms]:
    found = {kind: _document(stage.terms) for kind, stage in zip(STAGES, chain.stages, strict=True)}
    return {**found, "final": _document(chain.terms)}


def _covariance(chain: ChainResult) -> list[list[float | None]]:
    """Return the covariance; null in the rows and columns of terms that nothing bounds."""
    return [
        [None if chain.unseen[i] or chain.unseen[j] else float(value) for j, value in enumerate(row)]
        for i, row in enumerate(chain.covariance)
    ]


def _unobservable(chain: ChainResult, recording: Recording) -> list[Combination]:
    hidden = list(chain.unobservable)
    if recording.meta.site.gravity_mps2 is None:
        hidden.append(
            Combination(
                combination={"f_up": 1.0, "gravity": 1.0},
                text=(
                    "vertical accelerometer bias and gravity are one: 0.01 mg ≡ 10 mGal; normal gravity can be off by "
                    "some tens of mGal; give the surveyed gravity_mps2 to separate them"
                ),
            )
        )
    return hidden


def _reference_facts(physical: Physical, noise_source: str) -> dict[str, Any]:
    given = physical.recording.meta.reference.model_dump(exclude_none=True)
    gravity = "normal gravity" if physical.recording.meta.site.gravity_mps2 is None else "surveyed"
    return {**given, "gravity": gravity, "noise": noise_source, "significant_sigma": SIGNIFICANT_SIGMA}


def _site_facts(physical: Physical) -> dict[str, float]:
    site = physical.site
    return {
        "latitude_deg": math.degrees(site.latitude_rad),
        "height_m": site.height_m,
        "gravity_mps2": site.gravity_mps2,
    }


def _alignment_facts(alignment: Alignment) -> dict[str, Any]:
    roll, pitch, heading = (math.degrees(angle) for angle in roll_pitch_heading(alignment.C_tb))
    return {
        "level_source": alignment.level_source,
        "azimuth_source": alignment.azimuth_source,
        "azimuth_deg": math.degrees(alignment.azimuth_rad),
        "azimuth_sigma_deg": math.degrees(alignment.azimuth_sigma_rad),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": heading,
        "level_sigma_deg": math.degrees(alignment.level_sigma_rad),
        "C_tb": alignment.C_tb.tolist(),
    }


def _verification_facts(verification: Verification) -> dict[str, Any]:
    return {
        "passed": verification.passed,
        "chi_square": verification.statistic,
        "limit": verification.limit,
        "degrees_of_freedom": 6,
        "duration_s": verification.duration_s,
        "velocity_mps": verification.velocity_mps.tolist(),
        "attitude_rad": verification.attitude_rad.tolist(),
        "sigma_velocity_mps": verification.sigma[:3].tolist(),
        "sigma_attitude_rad": verification.sigma[3:].tolist(),
    }


def _condition_facts(
    physical: Physical, windows: Sequence[WindowRecord], checked: Mapping[str, Window]
) -> dict[str, Any]:
    rows = physical.rows(windows[0].start_s, windows[-1].end_s)
    samples = physical.recording.samples[rows]
    facts: dict[str, Any] = {
        "sample_rate_hz": float(1.0 / np.median(physical.interval_s[rows])),
        "samples": len(samples),
        "frames_repaired": sum(window.span.repaired for window in checked.values()),
    }
    temperature = np.asarray(samples["temperature"][:, 0], dtype=np.float64)
    if np.any(np.isfinite(temperature)):
        facts["temperature_mean_c"] = float(np.nanmean(temperature))
        facts["temperature_range_c"] = [float(np.nanmin(temperature)), float(np.nanmax(temperature))]
    return facts


def _block_facts(physical: Physical) -> dict[str, Any]:
    block = physical.recording.meta.block
    return {"gyro_kind": block.gyro_kind or "", "calibration": physical.calibration}


def _document_inputs(calibration: Calibration | None, model: BlockModel | None, recording: Recording) -> dict[str, str]:
    """Return the hashes of documents that did not come by the recording."""
    inputs = {}
    if calibration is not None:
        inputs["calibration (given)"] = calibration.sha256()
    if model is not None and recording.model_path is None:
        inputs["block model (given)"] = model.sha256()
    return inputs
