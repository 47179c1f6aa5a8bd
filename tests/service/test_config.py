"""Settings: where they come from, and that nothing wrong passes silently."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.config import ConfigError, Settings, load_settings


def test_without_anything_it_is_loopback_and_has_no_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("INERTRIM_LINK__URL", "INERTRIM_HTTP__HOST"):
        monkeypatch.delenv(name, raising=False)
    settings = load_settings()
    assert settings.link.url is None
    assert settings.http.host == "127.0.0.1"
    assert settings.store.path == Path("inertrim.db")


def test_command_line_goes_before_environment_before_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('[link]\nurl = "file"\nprotocol = "file"\nbit_rate = 115200\n')
    monkeypatch.setenv("INERTRIM_LINK__URL", "environment")
    monkeypatch.setenv("INERTRIM_LINK__PROTOCOL", "environment")
    link = load_settings(file, link={"url": "command line", "protocol": None}).link
    assert (link.url, link.protocol, link.bit_rate) == ("command line", "environment", 115200)


def test_text_of_the_environment_becomes_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INERTRIM_SITE__LATITUDE_DEG", "35.7")
    monkeypatch.setenv("INERTRIM_REFERENCE__AZIMUTH_DEG", "40")
    settings = load_settings()
    assert settings.site is not None
    assert (settings.site.latitude_deg, settings.reference.azimuth_deg) == (35.7, 40.0)


def test_paths_in_the_file_are_taken_from_its_folder(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text('[block]\ncalibration = "calibration.json"\n[store]\npath = "deep/inertrim.db"\n')
    settings = load_settings(file)
    assert settings.block.calibration == tmp_path / "calibration.json"
    assert settings.store.runs == tmp_path / "deep" / "inertrim-runs"


@pytest.mark.parametrize(
    ("text", "place", "remedy"),
    [
        ("[site]\nlatitude_rad = 0.6\n", "[site] latitude_rad", "latitude_deg"),
        ("[reference]\nazimuth_rad = 0.6\n", "[reference] azimuth_rad", "azimuth_deg"),
        ("[sequence]\nalign_ms = 30000\n", "[sequence] align_ms", "align_s"),
        ("[link]\nspeed = 9600\n", "[link] speed", "Known:"),
        ("[lnk]\nurl = 'x'\n", "[lnk]", "Did you mean link?"),
        ("[site]\nheight_m = 1\n", "[site] latitude_deg", "Give latitude_deg"),
        ("[site]\nlatitude_deg = 91\n", "[site] latitude_deg", "Correct the value"),
        ("[site]\nlatitude_deg = nan\n", "[site] latitude_deg", "Correct the value"),
        ("[link]\nbit_rate = 'fast'\n", "[link] bit_rate", "Correct the value"),
        ("[reference]\nroll_deg = 1.0\n", "[reference]", "roll_deg and pitch_deg"),
        ("[site\n", "not TOML", "Mend that line"),
        ("link = 3\n", "[link]", "Correct the value"),
    ],
)
def test_a_wrong_setting_is_refused_by_file_and_name(tmp_path: Path, text: str, place: str, remedy: str) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_settings(file)
    message = str(refused.value)
    assert place in message
    assert remedy in message
    if not place.endswith("latitude_deg") or "91" in text or "nan" in text:
        assert str(file) in message


@pytest.mark.parametrize(
    ("name", "place"),
    [("INERTRIM_SITE__LATITUDE_RAD", "latitude_deg"), ("INERTRIM_SEIT__X", "Did you mean site?")],
)
def test_a_wrong_variable_is_refused_by_name(monkeypatch: pytest.MonkeyPatch, name: str, place: str) -> None:
    monkeypatch.setenv(name, "1")
    with pytest.raises(ConfigError, match=name) as refused:
        load_settings()
    assert place in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.toml: No such file"):
        load_settings(tmp_path / "nothing.toml")


def test_every_setting_is_in_the_documentation() -> None:
    page = (Path(__file__).parents[2] / "docs" / "settings.md").read_text()
    for section, field in Settings.model_fields.items():
        annotation = field.annotation
        model = next(
            kind for kind in (annotation, *getattr(annotation, "__args__", ())) if hasattr(kind, "model_fields")
        )
        assert f"[{section}]" in page
        for key, about in model.model_fields.items():
            row = next((line for line in page.splitlines() if line.startswith(f"| `{key}` |")), None)
            assert row is not None, f"[{section}] {key} is not in docs/settings.md"
            if isinstance(about.default, int | float) and not isinstance(about.default, bool):
                assert f"{about.default:g}" in row.replace(",", ""), f"docs/settings.md: {key} is {about.default:g}"
