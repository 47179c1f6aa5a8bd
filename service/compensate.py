"""Recording → Result: the one path that the live service and the command line both take, bit for bit the same.

No wall clock, no randomness and no file name enters a number. The sequencer hands over the run's recording with the
windows it used; so does anybody later who reads that recording.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, Literal, get_args

from drivers.recording import Recording
from inertial.alignment import Alignment, coarse_alignment
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
from inertial.inertial_alignment import inertial_alignment
from inertial.verification import verify
from service import facts
from service.block_noise import audible, noise_of_span
from service.budget import rest_budget
from service.errors import RefusedInput
from service.methods import DEFAULT_METHOD, Findings, Material, method_named
from service.physical import Physical
from service.still_spans import described_rest, movement, noise_to_judge_by, still_spans
from service.verdict import Window, judge
from service.windows import (
    INERTIAL_ALIGN_S,
    NOMINAL_S,
    SHORTEST_S,
    STAGES,
    attitude_windows,
    automatic_windows,
    recorded_windows,
)

AlignmentKind = Literal["rest", "inertial"]
ALIGNMENTS: tuple[AlignmentKind, ...] = get_args(AlignmentKind)


def compensate(
    recording: Recording,
    *,
    method: str = DEFAULT_METHOD,
    alignment: AlignmentKind | None = None,
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
        for, windows are chosen: the first span that is still, 30 s to align, 3 × 60 s, 60 s to verify; or, with
        ``"optimal"``, two rests with turns of stated σ between them, the stages shared out.
    method
        ``"optimal"``: all pooled in one weighted least squares; ``"paper"``: three chained stages.
    alignment
        How the attitude that the reference does not give is found: ``"rest"`` by averaging, ``"inertial"`` on a
        launcher that sways. Without it as the recording's reference says.
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
    way = method_named(method)
    model = model or _model_of(recording)
    physical = Physical.of(recording, calibration, model)
    kind = _alignment_kind(physical, alignment)
    windows = _windows(physical, start_s, end_s, method, kind)
    material = _material(physical, windows, model, kind)
    last = windows[-1]
    try:
        found = way.findings(material)
        fresh = physical.span(last.start_s, last.end_s)
        verification = verify(fresh, found.at_rest, physical.site, physical.coefficients, found.noise)
    except ValueError as error:
        raise _refused(physical, error) from None
    checked = _checked(physical, windows, kind)
    judgement = judge(checked, found, verification)
    result = Result(
        software=f"inertrim {version('inertrim')}",
        method=method,
        state="READY" if judgement.fit else "FAULT",
        verdict=judgement.verdict,
        fit=judgement.fit,
        reasons=judgement.reasons,
        windows=windows,
        terms=_stage_terms(found),
        sigma=Sigma(f_mps2=found.sigma[:3], g_radps=found.sigma[3:]),
        order=list(found.order),
        covariance=_covariance(found),
        unobservable=_unobservable(found, recording),
        observability=found.observability,
        uncertainty=found.errors.to_document(found.alignment.C_tb, found.alignment.azimuth_rad),
        noise=found.noise,
        reference=facts.reference_facts(physical, _noise_source(model), kind),
        site=facts.site_facts(physical),
        alignment={
            **facts.alignment_facts(material.alignment),
            "refined": facts.alignment_facts(found.alignment),
        },
        verification=facts.verification_facts(verification),
        conditions=facts.condition_facts(physical, windows, checked),
        block=facts.block_facts(physical),
        inputs={**recording.inputs(), **_document_inputs(calibration, model, recording)},
    )
    return result.model_copy(update={"budget": rest_budget(result)})


def partial(
    recording: Recording, windows: Sequence[WindowRecord], *, method: str = DEFAULT_METHOD
) -> dict[str, StageTerms]:
    """Return the terms after each stage whose window is given, for progress while a run goes on.

    Parameters
    ----------
    windows
        ``align`` and, in order, the stages there are so far. The numbers are those of the final result.
    """
    model = _model_of(recording)
    physical = Physical.of(recording, model=model)
    material = _material(physical, windows, model, _alignment_kind(physical, None))
    stages = method_named(method).stages(material) if material.windows else []
    return {window.kind: _document(terms) for window, terms in zip(material.windows, stages, strict=True)}


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


def _refused(physical: Physical, error: ValueError) -> RefusedInput:
    if isinstance(error, RefusedInput):
        return error
    return RefusedInput(physical.name, f"{error}.", "Check its calibration, units and site.")


def _windows(
    physical: Physical, start_s: float | None, end_s: float | None, method: str, alignment: AlignmentKind
) -> list[WindowRecord]:
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
    nominal = {**NOMINAL_S, "align": INERTIAL_ALIGN_S} if alignment == "inertial" else NOMINAL_S
    if method == "optimal":
        known = [(t.start_s, t.end_s) for t in physical.turns_between(low, high) if t.angle_sigma_deg is not None]
        if (shared := attitude_windows(still, known, nominal)) is not None:
            return shared
    if any(end - begin >= SHORTEST_S for begin, end in still):
        return automatic_windows(still, physical.name, nominal)
    return automatic_windows(described_rest(physical, low, high), physical.name, nominal)


def _material(
    physical: Physical, windows: Sequence[WindowRecord], model: BlockModel | None, alignment: AlignmentKind
) -> Material:
    """Return what there is for a method to work on, with the windows up to now."""
    stages = [window for window in windows if window.kind in STAGES]
    _refuse_turns_outside(physical, windows)
    return Material(
        physical=physical,
        alignment=_aligned(physical, windows[0], model, alignment),
        windows=stages,
        spans=[physical.span(window.start_s, window.end_s) for window in stages],
        noise=[_noise(physical, windows[: k + 2], model) for k in range(len(stages))],
    )


def _refuse_turns_outside(physical: Physical, windows: Sequence[WindowRecord]) -> None:
    """Refuse a turn beside ``align`` or ``verify``: an attitude that no stage has seen is neither start nor proof."""
    for before, after in itertools.pairwise(windows):
        outside = before.kind == "align" or after.kind == "verify"
        if outside and physical.turns_between(before.end_s, after.start_s):
            raise RefusedInput(
                physical.name,
                f"the block turns between its windows {before.kind} and {after.kind}.",
                "Put align at the attitude of the first stage and verify at that of the last.",
            )


def _noise(physical: Physical, windows: Sequence[WindowRecord], model: BlockModel | None) -> Noise:
    """Return the noise to weigh with: the model's, else as the windows up to now show it (``free``)."""
    if model is not None and _noise_source(model) == "block model":
        return audible(model.noise)
    longest = max(_contiguous(windows), key=lambda span: span[1] - span[0])
    return noise_of_span(physical.span(*longest), physical.name).model_copy(update={"free": True})


def _noise_source(model: BlockModel | None) -> str:
    given = model is not None and not model.noise.free and model.noise != Noise()
    return "block model" if given else "these data"


def _contiguous(windows: Sequence[WindowRecord]) -> list[tuple[float, float]]:
    """Return the spans that windows following one another without a pause make."""
    spans = [(windows[0].start_s, windows[0].end_s)]
    for window in windows[1:]:
        if window.start_s == spans[-1][1]:
            spans[-1] = (spans[-1][0], window.end_s)
        else:
            spans.append((window.start_s, window.end_s))
    return spans


def _alignment_kind(physical: Physical, asked: AlignmentKind | None) -> AlignmentKind:
    return asked or physical.recording.meta.reference.alignment


def _aligned(physical: Physical, window: WindowRecord, model: BlockModel | None, kind: AlignmentKind) -> Alignment:
    """Return the attitude that the window ``align`` leads to."""
    align = inertial_alignment if kind == "inertial" else coarse_alignment
    # On a swaying launcher the data's own noise is sway: only a model tells that of the sensors.
    noise = audible(model.noise) if model is not None and _noise_source(model) == "block model" else Noise()
    span, reference = physical.span(window.start_s, window.end_s), physical.reference_at(window.start_s)
    try:
        return align(span, physical.coefficients, physical.site, reference, noise)
    except ValueError as error:
        raise _refused(physical, error) from None


def _checked(physical: Physical, windows: Sequence[WindowRecord], alignment: AlignmentKind) -> dict[str, Window]:
    """Return what the checks look at; a launcher may sway while it is aligned in an inertial frame."""
    quiet = noise_to_judge_by(physical, windows[0].start_s, windows[-1].end_s)
    return {
        window.kind: Window(
            physical.span(window.start_s, window.end_s),
            physical.recording.samples[physical.rows(window.start_s, window.end_s)],
            None
            if window.kind == "align" and alignment == "inertial"
            else movement(physical, quiet, window.start_s, window.end_s),
        )
        for window in windows
    }


def _document(terms: Terms) -> StageTerms:
    return StageTerms(f_mps2=terms.f_mps2.tolist(), g_radps=terms.g_radps.tolist())


def _stage_terms(found: Findings) -> dict[Any, StageTerms]:
    stages = {kind: _document(terms) for kind, terms in zip(STAGES, found.stages, strict=True)}
    return {**stages, "final": _document(found.terms)}


def _covariance(found: Findings) -> list[list[float | None]]:
    """Return the covariance; null in the rows and columns of what nothing bounds."""
    return [
        [None if found.unseen[i] or found.unseen[j] else float(value) for j, value in enumerate(row)]
        for i, row in enumerate(found.covariance)
    ]


def _unobservable(found: Findings, recording: Recording) -> list[Combination]:
    hidden = list(found.unobservable)
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


def _document_inputs(calibration: Calibration | None, model: BlockModel | None, recording: Recording) -> dict[str, str]:
    """Return the hashes of documents that did not come by the recording."""
    inputs = {}
    if calibration is not None:
        inputs["calibration (given)"] = calibration.sha256()
    if model is not None and recording.model_path is None:
        inputs["block model (given)"] = model.sha256()
    return inputs
