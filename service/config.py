"""Settings of the running service, from one TOML file and the environment (``INERTRIM_SECTION__KEY``).

A key that does not exist is refused by name, with the key that was probably meant: a unit that slips through
(``latitude_rad``) would cost more than a start that fails.
"""

from __future__ import annotations

import difflib
import os
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsConfigDict

from drivers.recording_meta import ReferenceMeta, SiteMeta

ENVIRONMENT_PREFIX = "INERTRIM_"
UNITS = ("deg", "rad", "m", "km", "ft", "s", "ms", "min", "h", "hz", "khz", "mps2", "mg", "c", "f", "k", "dps", "cpmin")


class ConfigError(ValueError):
    """A setting is refused; the text names the file or variable, the key, the reason and the remedy."""


class Section(BaseModel):
    """Common rules of every section: no unknown key, no NaN or infinity, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LinkSettings(Section):
    """``[link]``: the serial line. Without ``url`` the service stays OFFLINE. Times in simulated seconds."""

    url: str | None = None
    protocol: str = "native"
    options: dict[str, str | int | float | bool] = {}
    bit_rate: int = Field(921_600, ge=1_200, le=50_000_000)
    stale_after_s: float = Field(0.5, gt=0, le=60)


class SiteSettings(SiteMeta):
    """``[site]``: where the launcher stands, as in a recording's TOML; ``gravity_mps2`` where it was surveyed."""

    model_config = ConfigDict(strict=False)  # the environment gives text

    latitude_deg: float = Field(ge=-90, le=90)


class ReferenceSettings(ReferenceMeta):
    """``[reference]``: what is known of the attitude, as in a recording's TOML. No roll and pitch: levels itself."""

    model_config = ConfigDict(strict=False)


class BlockSettings(Section):
    """``[block]``: what hangs on the line. Files by path; without a calibration the ideal block is assumed."""

    calibration: Path | None = None
    model: Path | None = None
    gyro_kind: Literal["dtg", "laser", "fibre", "mems"] = "dtg"
    sample_rate_hz: float | None = Field(None, gt=0, le=100_000)


class SequenceSettings(Section):
    """``[sequence]``: steps, limits and time-outs [simulated or block seconds]."""

    power_up_timeout_s: float = Field(30.0, gt=0)
    self_test_timeout_s: float = Field(20.0, gt=0)
    settling_window_s: float = Field(60.0, ge=5)
    settling_max_s: float = Field(1_800.0, gt=0)
    temperature_slope_cpmin: float = Field(0.3, gt=0)
    accel_drift_mg_per_min: float = Field(0.05, gt=0)
    gyro_drift_dph_per_min: float = Field(0.3, gt=0)
    align_s: float = Field(30.0, ge=5, le=600)
    stage_s: float = Field(60.0, ge=10, le=600)
    verify_s: float = Field(60.0, ge=10, le=600)
    lost_fraction: float = Field(0.05, gt=0, lt=1)
    stuck_s: float = Field(2.0, gt=0)
    still_again_s: float = Field(5.0, ge=1)
    hold_max_s: float = Field(600.0, gt=0)
    hold_max_count: int = Field(20, ge=1)
    restart_max_count: int = Field(3, ge=0)
    same_tilt_deg: float = Field(0.003, gt=0)
    same_heading_deg: float = Field(0.05, gt=0)
    carry_deg: float = Field(5.0, ge=0, le=30)
    ready_temperature_change_c: float = Field(2.0, gt=0)
    validity_s: float = Field(1_800.0, gt=0)


class StoreSettings(Section):
    """``[store]``: the database file, or the database that launchers share; runs' folders lie beside ``path``."""

    path: Path = Path("inertrim.db")
    database_url: str | None = None
    launcher: str = Field("launcher", min_length=1, max_length=100)

    @property
    def runs(self) -> Path:
        """Folder that holds one folder a run."""
        return self.path.with_name(self.path.stem + "-runs")

    @property
    def database(self) -> Path | str:
        """What the store is opened by."""
        return self.path if self.database_url is None else self.database_url


class HttpSettings(Section):
    """``[http]``: where the console finds the service."""

    host: str = "127.0.0.1"
    port: int = Field(8780, ge=0, le=65_535)
    certificate: Path | None = None
    key: Path | None = None
    requests_per_s: float = Field(2_000.0, gt=0)
    commands_per_s: float = Field(50.0, gt=0)
    event_clients: int = Field(100, ge=1)


class ConditionsSettings(Section):
    """``[conditions]``: limits of the go / no-go conditions that no other section holds."""

    calibration_age_days: float = Field(365.0, gt=0)
    accel_term_mg: float = Field(1.0, gt=0)
    gyro_term_dph: float = Field(10.0, gt=0)
    clock_jump_s: float = Field(2.0, gt=0)
    disk_free_mb: float = Field(200.0, ge=0)
    rate_error: float = Field(1e-3, gt=0)


class LibrarySettings(Section):
    """``[library]``: folders whose calibrations, block models and recordings the API lists."""

    calibrations: Path | None = None
    models: Path | None = None
    recordings: Path | None = None


class LogSettings(Section):
    """``[log]``: lines on standard error."""

    format: Literal["json", "console"] = "json"
    level: Literal["debug", "info", "warning", "error"] = "info"


class TimeSettings(Section):
    """``[time]``: simulated seconds per real second, and the CLOCK_MONOTONIC value at simulated time 0."""

    speed: float = Field(1.0, gt=0, le=1_000)
    epoch_s: float | None = None


class Settings(BaseSettings):
    """All settings. Precedence: what the command line gives, the environment, the file, the defaults."""

    model_config = SettingsConfigDict(
        env_prefix=ENVIRONMENT_PREFIX, env_nested_delimiter="__", extra="forbid", frozen=True, allow_inf_nan=False
    )

    link: LinkSettings = LinkSettings()
    site: SiteSettings | None = None
    reference: ReferenceSettings = ReferenceSettings()
    block: BlockSettings = BlockSettings()
    sequence: SequenceSettings = SequenceSettings()
    store: StoreSettings = StoreSettings()
    http: HttpSettings = HttpSettings()
    conditions: ConditionsSettings = ConditionsSettings()
    library: LibrarySettings = LibrarySettings()
    log: LogSettings = LogSettings()
    time: TimeSettings = TimeSettings()


def load_settings(path: Path | None = None, **overrides: dict[str, Any]) -> Settings:
    """Read the settings.

    Parameters
    ----------
    path
        TOML file; None reads the environment alone, and with nothing there the service is OFFLINE on loopback.
    **overrides
        Sections given on the command line, e.g. ``link={"url": "/dev/ttyUSB0"}``; None values are skipped.

    Raises
    ------
    ConfigError
        With the file or variable, the key, the reason and the remedy. Relative paths in the file are taken from
        the file's folder.
    """
    table = {} if path is None else _read_table(path)
    _refuse_unknown_variables()
    given: dict[str, Any] = {
        section: {key: value for key, value in values.items() if value is not None}
        for section, values in overrides.items()
    }
    try:
        return _settings_over(table)(**given)
    except ValidationError as error:
        raise ConfigError(_explain(error, table, path)) from None


def _settings_over(table: dict[str, Any]) -> type[Settings]:
    """Return the settings class whose weakest source is ``table``."""

    class FromTable(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            del dotenv_settings, file_secret_settings
            return init_settings, env_settings, InitSettingsSource(settings_cls, table)

    return FromTable


def _read_table(path: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}. Give the settings file that exists, or none.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}. Mend that line.") from None
    for section, key in _paths():
        value = table.get(section, {}).get(key) if isinstance(table.get(section), dict) else None
        if isinstance(value, str):
            table[section][key] = str(path.parent / value)
    return table


def _paths() -> list[tuple[str, str]]:
    """Return section and key of every setting that is a path: it is meant from the settings file's folder."""
    sections = {name: field.annotation for name, field in Settings.model_fields.items()}
    return [
        (section, key)
        for section, kind in sections.items()
        if isinstance(kind, type) and issubclass(kind, BaseModel)
        for key, field in kind.model_fields.items()
        if field.annotation in (Path, Path | None)
    ]


def _refuse_unknown_variables() -> None:
    """Refuse ``INERTRIM_…`` variables that name no section: pydantic-settings would pass over them silently."""
    for name in os.environ:
        if not name.upper().startswith(ENVIRONMENT_PREFIX):
            continue
        section = name.upper().removeprefix(ENVIRONMENT_PREFIX).split("__")[0].lower()
        if section not in Settings.model_fields:
            raise ConfigError(f"environment variable {name}: no section {section!r}. {_nearest(section, _sections())}")


def _sections() -> list[str]:
    return sorted(Settings.model_fields)


def _keys(section: str) -> list[str]:
    annotation: Any = Settings.model_fields[section].annotation
    model = next(
        (kind for kind in (annotation, *getattr(annotation, "__args__", ())) if hasattr(kind, "model_fields")), None
    )
    return sorted(model.model_fields) if model is not None else []


def _explain(error: ValidationError, table: dict[str, Any], path: Path | None) -> str:
    """Return one clear line on the first thing that is wrong."""
    # A wrong name comes before what is missing: it is most often why the right one is missing.
    first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    place = [str(part) for part in first["loc"]]
    section, key = place[0], ".".join(place[1:])
    where = _origin(section, key, table, path)
    if first["type"] == "extra_forbidden":
        known = _keys(section) if key else _sections()
        return f"{where}: there is no such setting. {_nearest(place[-1], known)}"
    if first["type"] == "missing":
        return f"{where}: is missing. Give {key} in section [{section}]."
    return f"{where}: {first['msg']} (got {first.get('input')!r}). Correct the value; docs/settings.md lists them."


def _origin(section: str, key: str, table: dict[str, Any], path: Path | None) -> str:
    name = f"[{section}] {key}" if key else f"[{section}]"
    part: Any = table
    for step in [section, *filter(None, key.split("."))]:
        part = part.get(step) if isinstance(part, dict) else None
    if part is not None and path is not None:
        return f"{path}: {name}"
    variable = ENVIRONMENT_PREFIX + "__".join(filter(None, [section, *key.split(".")])).upper()
    if any(variable == known.upper() for known in os.environ):
        return f"environment variable {variable}: {name}"
    return f"settings: {name}"


def _nearest(word: str, known: list[str]) -> str:
    """Return the remedy for a wrong name: the same quantity in its own unit, the closest spelling, or the list."""
    stem, _, unit = word.rpartition("_")
    if unit.lower() in UNITS:
        same = [name for name in known if name.rpartition("_")[0] == stem]
        if same:
            return f"It is given in another unit here: {same[0]}."
    close = difflib.get_close_matches(word, known, n=1)
    return f"Did you mean {close[0]}?" if close else f"Known: {', '.join(known)}."
