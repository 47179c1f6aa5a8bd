"""A recording as the estimators take it: spans of increments, site, reference and coefficients in SI."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.recording import Recording
from drivers.recording_meta import RecordingMeta, TurnMeta
from drivers.samples import intervals_s
from inertial.alignment import Reference
from inertial.attitude import body_to_tangent, roll_pitch_heading, rotation_matrix
from inertial.documents import BlockModel, Calibration, parse_document
from inertial.earth import Site
from inertial.error_model import Coefficients
from inertial.increments import Increments, increments_of
from service.errors import RefusedInput

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Physical:
    """One recording with everything outside its samples in SI; ``calibration`` says where the coefficients are from."""

    recording: Recording
    interval_s: Array
    site: Site
    reference: Reference
    coefficients: Coefficients
    calibration: str

    @classmethod
    def of(
        cls,
        recording: Recording,
        calibration: Calibration | None = None,
        model: BlockModel | None = None,
        *,
        needs_site: bool = True,
    ) -> Physical:
        """Convert a recording; its own calibration gives way to one given here and goes before a model's.

        ``needs_site``: what is asked of it depends on where it was made; else an unknown latitude counts as zero.

        Raises
        ------
        RecordingError, DocumentError, RefusedInput
            The site lacks its latitude, the calibration is damaged, or its coefficients cannot be used.
        """
        if needs_site:
            recording.require("site.latitude_deg")
        coefficients, origin = _coefficients(recording, calibration, model)
        return cls(
            recording, intervals_s(recording.samples), site_of(recording), reference_of(recording), coefficients, origin
        )

    @property
    def time_s(self) -> Array:
        """Return the device time (n,) [s] at the end of every sample."""
        return np.asarray(self.recording.samples["time"], dtype=np.float64)

    @property
    def name(self) -> str:
        """Return how messages call the recording."""
        return str(self.recording.path)

    @property
    def start_s(self) -> float:
        """Return where the first sample's interval begins [s]."""
        return float(self.time_s[0] - self.interval_s[0])

    @property
    def end_s(self) -> float:
        """Return just after the last sample [s], so that a half-open span up to here holds it."""
        return float(np.nextafter(self.time_s[-1], math.inf))

    def rows(self, start_s: float, end_s: float) -> slice:
        """Return the rows whose time lies in the half-open span."""
        low, high = np.searchsorted(self.time_s, (start_s, end_s))
        return slice(int(low), int(high))

    def span(self, start_s: float, end_s: float) -> Increments:
        """Return the increments of a half-open span of device time, lost samples interpolated."""
        rows = self.rows(start_s, end_s)
        samples = self.recording.samples[rows]
        if len(samples) == 0:
            raise RefusedInput(
                self.name,
                f"its data, {self.start_s:g} to {self.end_s:g} s, hold nothing of the span asked for.",
                "Name a span within the data.",
            )
        return increments_of(
            samples["sequence"], samples["time"], samples["dv"], samples["dtheta"], self.interval_s[rows]
        )

    def reference_at(self, time_s: float) -> Reference:
        """Return the reference as the turns described before a device time have left it."""
        reference = self.reference
        roll, pitch = reference.roll_rad or 0.0, reference.pitch_rad or 0.0
        C_tb = body_to_tangent(roll, pitch, reference.heading_rad)
        for motion in self.recording.meta.motion:
            if motion.kind == "turn" and motion.end_s <= time_s:
                angle = math.radians(motion.rate_dps) * (motion.end_s - motion.start_s)
                turn = rotation_matrix(np.asarray(motion.axis) / np.linalg.norm(motion.axis) * angle)
                C_tb = C_tb @ turn if motion.frame == "body" else turn @ C_tb
        roll, pitch, heading = roll_pitch_heading(C_tb)
        if reference.roll_rad is None:
            return replace(reference, heading_rad=heading)
        return replace(reference, roll_rad=roll, pitch_rad=pitch, heading_rad=heading)

    def turns_between(self, start_s: float, end_s: float) -> list[TurnMeta]:
        """Return the turns described within a span of device time."""
        motions = self.recording.meta.motion
        return [m for m in motions if m.kind == "turn" and m.start_s >= start_s and m.end_s <= end_s]


def site_of(recording: Recording) -> Site:
    """Return the site in SI."""
    try:
        return site_of_meta(recording.meta)
    except ValueError as error:
        raise RefusedInput(f"{recording.meta_path}: [site]", f"{error}.", "Correct it.") from None


def site_of_meta(meta: RecordingMeta) -> Site:
    """Return the site of a TOML in SI."""
    given = meta.site
    return Site.at(math.radians(given.latitude_deg or 0.0), given.height_m or 0.0, given.gravity_mps2)


def reference_of(recording: Recording) -> Reference:
    """Return what is known from outside, in SI; an azimuth or level without σ counts as exact."""
    given = recording.meta.reference
    return Reference(
        azimuth_rad=_radians(given.azimuth_deg),
        azimuth_sigma_rad=math.radians(given.azimuth_sigma_deg or 0.0),
        roll_rad=_radians(given.roll_deg),
        pitch_rad=_radians(given.pitch_deg),
        heading_rad=math.radians(given.heading_deg),
        level_sigma_rad=math.radians(given.level_sigma_deg or 0.0),
    )


def _radians(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)


def _coefficients(
    recording: Recording, calibration: Calibration | None, model: BlockModel | None
) -> tuple[Coefficients, str]:
    path = recording.calibration_path
    if calibration is not None:
        document, origin, place = calibration.coefficients, "given", "calibration"
    elif path is not None:
        document = parse_document(Calibration, path.read_bytes(), str(path)).coefficients
        origin, place = path.name, str(path)
    elif model is not None:
        document, origin, place = model.calibration, "block model", "block model"
    else:
        return Coefficients.ideal(), "ideal"
    try:
        return Coefficients.from_document(document), origin
    except ValueError as error:
        raise RefusedInput(place, f"{error}.", "Correct the coefficients.") from None
