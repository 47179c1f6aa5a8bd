"""A bench for the sequencer in pure simulated time: a block of noise on a desk, orders answered by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import SampleArray, Status, empty_samples
from inertial.documents import Noise, Result, Sigma, StageTerms
from service.config import SequenceSettings
from service.orders import AskBlock, Conclude, Estimate, Keep, Order, Reply
from service.sequencer import LineView, Sequencer
from service.states import Name

RATE_HZ = 25.0
BATCH = 25
TERMS = StageTerms(f_mps2=[1e-3, -2e-3, 3e-3], g_radps=[1e-5, 2e-5, -3e-5])


def result(fit: bool = True) -> Result:
    """Return a result document with nothing but what the sequencer looks at."""
    return Result(
        software="test",
        method="paper",
        state="READY",
        verdict="shift compensated" if fit else "not fit",
        fit=fit,
        reasons=["proved"] if fit else ["chi-square 99 is above 22.5"],
        windows=[],
        terms={"final": TERMS},
        sigma=Sigma(f_mps2=[None] * 3, g_radps=[None] * 3),
        order=[],
        covariance=[],
        unobservable=[],
        noise=Noise(),
        reference={},
        site={},
        alignment={},
        verification=None,
        conditions={},
        block={},
        inputs={},
    )


class Judge:
    """Stillness by decree."""

    def __init__(self) -> None:
        self.still = True

    def feed(self, samples: SampleArray) -> bool:
        assert len(samples)
        return self.still

    def reset(self) -> None:
        pass


class Bench:
    """Drives a sequencer: ``run`` lets simulated time pass, batch by batch; ``answers`` says how orders end."""

    def __init__(self, **settings: Any) -> None:
        self.judge = Judge()
        short = {"settling_window_s": 12.0, "align_s": 10.0, "stage_s": 20.0, "verify_s": 20.0}
        self.settings = SequenceSettings(**{**short, **settings})
        self.core = Sequencer(self.settings, self.judge, utc=lambda: "2026-01-01T00:00:00Z")
        self.now_s = 100.0
        self.device_s = 0.0
        self.sequence = 0
        self.random = np.random.default_rng(1)
        self.line = "STREAMING"
        self.status = Status(0)
        self.temperature_c = 30.0
        self.warming_c_per_s = 0.0
        self.turning_radps = np.zeros(3)
        self.attitude = Rotation.identity()
        self.lose = 0.0
        self.stuck: int | None = None
        self.alive = True
        self.seen: list[tuple[str, str, str]] = []
        self.details: list[str] = []
        self.concluded: list[Conclude] = []
        self.kept: list[Keep] = []
        self.estimates: list[Estimate] = []
        self.asked: list[str] = []
        self.replies: list[Reply] = []
        self.written: StageTerms | None = None
        self.answers: dict[str, Callable[[Order], Reply | None]] = {}

    # ------------------------------------------------------------------ the world

    def batch(self) -> SampleArray:
        samples = empty_samples(BATCH)
        steps = np.arange(1, BATCH + 1)
        samples["time"] = self.device_s + steps / RATE_HZ
        samples["sequence"] = self.sequence + steps
        samples["dv"] = self.random.normal(0, 1e-7, (BATCH, 3)) + self.up() * 9.8 / RATE_HZ
        samples["dtheta"] = self.random.normal(0, 1e-8, (BATCH, 3)) + self.turning_radps / RATE_HZ
        if self.stuck is not None:
            samples["dtheta"][:, self.stuck] = 1.25e-6
        samples["temperature"] = self.temperature_c + self.warming_c_per_s * (samples["time"] - self.device_s)[:, None]
        self.temperature_c += self.warming_c_per_s * BATCH / RATE_HZ
        samples["status"] = int(self.status)
        self.device_s, self.sequence = float(samples["time"][-1]), int(samples["sequence"][-1])
        return samples[self.random.random(BATCH) >= self.lose]

    def up(self) -> NDArray[np.float64]:
        """The direction of the specific force in the block, sample by sample, as it turns."""
        steps = np.arange(1, BATCH + 1)[:, None] / RATE_HZ
        attitudes = self.attitude * Rotation.from_rotvec(self.turning_radps * steps)
        self.attitude = attitudes[-1]
        return np.asarray(attitudes.inv().apply([0.0, 0.0, 1.0]))

    def turn(self, rate_radps: NDArray[np.float64], seconds: float) -> None:
        """Turn the block about its own axes for a while."""
        self.turning_radps = rate_radps
        self.run(seconds)
        self.turning_radps = np.zeros(3)

    def restart_block(self) -> None:
        self.device_s, self.sequence = 0.0, 0

    def step(self) -> None:
        """Let a second pass; what was asked in the one before is answered first."""
        self.now_s += BATCH / RATE_HZ
        replies, self.replies = self.replies, []
        for reply in replies:
            self.core.on_reply(reply)
        if self.alive:
            samples = self.batch()
            if self.line == "STREAMING":
                self.core.on_batch(samples, self.now_s)
        self.core.on_tick(self.now_s, LineView(self.line, 0.01 if self.line == "STREAMING" else 3.0))
        self.answer()
        while self.core.transitions:
            record = self.core.transitions.popleft()
            self.seen.append((record.source, record.target, record.reason))
            self.details.append(record.detail)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE_HZ / BATCH)):
            self.step()

    def until(self, state: Name, limit_s: float = 900.0) -> None:
        """Let time pass until a state is reached."""
        end_s = self.now_s + limit_s
        while self.core.state is not state:
            assert self.now_s < end_s, f"waited {limit_s} s for {state}, stands in {self.core.snapshot()}; {self.seen}"
            self.step()

    # ------------------------------------------------------------------ the others

    def answer(self) -> None:
        while self.core.orders:
            order = self.core.orders.popleft()
            if isinstance(order, Keep):
                self.kept.append(order)
                continue
            what = order.what if isinstance(order, AskBlock) else type(order).__name__
            reply = self.answers[what](order) if what in self.answers else self.ordinary(order)
            if reply is not None:
                self.replies.append(reply)

    def ordinary(self, order: Order) -> Reply | None:
        """Return what a good block and a good estimator answer."""
        assert not isinstance(order, Keep)
        if isinstance(order, AskBlock):
            self.asked.append(order.what)
            if order.what == "write":
                self.written = order.terms
            return Reply(order.token, order.what, self.written if order.what == "read_back" else None)
        if isinstance(order, Estimate):
            self.estimates.append(order)
            return Reply(order.token, "final", result()) if order.final else None
        self.concluded.append(order)
        return Reply(order.token, "conclude")

    def start(self, run_id: str = "run-1") -> None:
        self.core.start(run_id, self.now_s)
        self.answer()

    def at(self, state: Name) -> Bench:
        """Start a run and go to a state."""
        self.start()
        self.until(state)
        return self
