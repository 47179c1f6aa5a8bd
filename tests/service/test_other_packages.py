"""Other packages' protocols and effects, installed as pip leaves them: found by entry point, or refused by name."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.protocols import get_protocol, option_names, protocol_names
from drivers.protocols.base import ProtocolError
from drivers.stream import StreamDecoder
from inertial.attitude import body_to_tangent
from inertial.documents import BlockModel, EffectEntry
from inertial.earth import Site
from simulators.block import SimulatedBlock
from simulators.effects import effects
from simulators.effects.base import EffectError
from simulators.motion import Setup
from simulators.scenarios import effect

PROTOCOL = '''
from drivers.protocols.native import Native


class Theirs(Native):
    """Our frames under another name, at another bit rate."""

    name = "theirs"
    bit_rates = (57600,)

    def __init__(self, *, wings=2):
        self.wings = wings
'''
EFFECT = """
from simulators.effects.bias_shift import BiasShift


class Brought(BiasShift):
    name = "brought"


EFFECT = Brought()
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, as site-packages is one."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    yield folder
    effects.cache_clear()
    for name in [name for name in sys.modules if name.startswith("theirs")]:
        del sys.modules[name]


def install(site: Path, module: str, code: str, entry_points: str) -> None:
    """Leave a package behind as an installer does."""
    (site / f"{module}.py").write_text(code)
    facts = site / f"{module}-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(entry_points)
    effects.cache_clear()


def test_a_protocol_of_another_package_is_a_protocol_like_ours(site: Path) -> None:
    assert "theirs" not in protocol_names()
    install(site, "theirs_ins", PROTOCOL, "[inertrim.protocols]\ntheirs = theirs_ins:Theirs\n")
    assert "theirs" in protocol_names()
    assert option_names("theirs") == ["wings"]
    protocol = get_protocol("theirs", wings=4)
    assert type(protocol).__module__ == "theirs_ins"
    with pytest.raises(ProtocolError, match="protocol theirs has no option legs; it knows wings"):
        get_protocol("theirs", legs=2)


def test_the_command_line_reads_with_it(site: Path, tmp_path: Path) -> None:
    install(site, "theirs_ins", PROTOCOL, "[inertrim.protocols]\ntheirs = theirs_ins:Theirs\n")
    (tmp_path / "line.bin").write_bytes(frames())
    done = convert(site, tmp_path, "theirs")
    assert (done.returncode, done.stderr) == (0, "")
    assert "300 samples" in done.stdout


@pytest.mark.parametrize(
    ("code", "target", "words"),
    [
        ("import no_such_module_of_theirs", "theirs_ins:Theirs", "does not load: ModuleNotFoundError"),
        ("1 / 0", "theirs_ins:Theirs", "does not load: ZeroDivisionError"),
        (PROTOCOL, "theirs_ins:Ours", "does not load: AttributeError"),
        ("Theirs = 3", "theirs_ins:Theirs", "is no subclass of drivers.protocols.base.Protocol"),
    ],
)
def test_a_protocol_that_does_not_load_is_named_with_its_package(
    site: Path, code: str, target: str, words: str
) -> None:
    install(site, "theirs_ins", code, f"[inertrim.protocols]\ntheirs = {target}\n")
    with pytest.raises(ProtocolError, match=rf"protocol theirs: .*package theirs_ins.*{words}") as refused:
        get_protocol("theirs")
    assert "Update or remove that package" in str(refused.value)
    assert len(frames()) == 300 * 60  # ours still load


def test_the_command_line_refuses_it_in_a_line(site: Path, tmp_path: Path) -> None:
    install(site, "theirs_ins", "1 / 0", "[inertrim.protocols]\ntheirs = theirs_ins:Theirs\n")
    (tmp_path / "line.bin").write_bytes(frames())
    done = convert(site, tmp_path, "theirs")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "package theirs_ins" in done.stderr


def test_an_effect_of_another_package_shifts_what_a_block_reads(site: Path) -> None:
    install(site, "theirs_effects", EFFECT, "[inertrim.effects]\nbrought = theirs_effects:EFFECT\n")
    assert type(effects()["brought"]).__module__ == "theirs_effects"
    shifted, plain = (
        velocity_gained(entries) for entries in ([effect("brought", "accel_x", shift=(0.01, "m/s^2"))], [])
    )
    assert shifted - plain == pytest.approx(0.01 * 3.0, abs=300 * 2.0**-24)  # a step of the frame in each sample


@pytest.mark.parametrize(
    ("code", "words"), [("1 / 0", "ZeroDivisionError"), ("EFFECT = 3", "is no simulators.effects")]
)
def test_an_effect_that_does_not_load_is_named_with_its_package(site: Path, code: str, words: str) -> None:
    install(site, "theirs_effects", code, "[inertrim.effects]\nbrought = theirs_effects:EFFECT\n")
    with pytest.raises(EffectError, match=rf"effect brought: .*theirs_effects.*{words}"):
        effects()


def velocity_gained(entries: list[EffectEntry]) -> float:
    """Return what the x accelerometer of a block at rest gains in 3 s [m/s]."""
    setup = Setup(Site.at(0.6, 100.0), 0.7, body_to_tangent(0.1, 0.2, 0.3))
    samples = SimulatedBlock(BlockModel(), setup, rate_hz=100.0, effects=entries).generate(300)
    return float(samples["dv"][:, 0].sum())


def frames() -> bytes:
    """Return native frames of a block at rest."""
    from drivers.samples import empty_samples

    samples = empty_samples(300, 3)
    samples["sequence"] = np.arange(300)
    samples["time"] = (samples["sequence"] + 1) / 100
    data = get_protocol("native").encode_samples(samples)
    decoder = StreamDecoder(get_protocol("native"))
    decoder.feed(data, 0.0)
    assert len(decoder.take().samples) == 300
    return data


def convert(site: Path, folder: Path, protocol: str) -> subprocess.CompletedProcess[str]:
    """Run ``inertrim convert`` in a process of its own that has the folder on its path."""
    arguments = ["convert", folder / "line.bin", "--protocol", protocol, "--out", folder / "a.csv"]
    command = [sys.executable, "-m", "service.cli", *map(str, arguments)]
    root = str(Path(__file__).resolve().parents[2])
    return subprocess.run(
        command, env={**os.environ, "PYTHONPATH": os.pathsep.join((str(site), root))}, capture_output=True, text=True
    )
