"""What a study may vary: a factor a line, its unit in its name, with its range and what holds where it is not named."""

from __future__ import annotations

from dataclasses import dataclass

Level = float | str


@dataclass(frozen=True)
class Factor:
    """One quantity of a trial. ``choices``: the words or whole numbers it takes, instead of a range."""

    default: Level
    low: float = 0.0
    high: float = 0.0
    choices: tuple[Level, ...] = ()

    def refusal(self, level: Level) -> str | None:
        """Return why a level cannot be, or None."""
        if self.choices:
            known = ", ".join(str(choice) for choice in self.choices)
            return None if level in self.choices else f"{level!r} is none of {known}"
        if not isinstance(level, float):
            return f"{level!r} is not a number"
        return None if self.low <= level <= self.high else f"{level:g} is not within {self.low:g} to {self.high:g}"


FACTORS: dict[str, Factor] = {
    "latitude_deg": Factor(35.7, -89.0, 89.0),
    "height_m": Factor(1200.0, -500.0, 20_000.0),
    "azimuth_deg": Factor(40.0, -360.0, 360.0),
    "azimuth_sigma_deg": Factor(0.1, 0.0, 10.0),
    "roll_deg": Factor(0.0, -180.0, 180.0),
    "pitch_deg": Factor(0.0, -85.0, 85.0),
    "level_sigma_deg": Factor(0.003, 0.0, 1.0),
    "storage_months": Factor(24.0, 0.0, 600.0),
    "noise": Factor(1.0, 0.01, 100.0),
    "vibration_grms": Factor(0.0, 0.0, 20.0),
    "stage_s": Factor(60.0, 10.0, 600.0),
    "method": Factor("optimal", choices=("optimal", "paper")),
    "noise_source": Factor("data", choices=("data", "model")),
    "attitudes": Factor(1.0, choices=(1.0, 2.0)),
}
