"""What the demo shows: the run's path while it goes on, and a table at its end."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from service.live_view import LiveView, path_picture
from service.report import DEG_H_RADPS, MG_MPS2, SENSORS, STAGE_NAMES


class DemoView(LiveView):
    """Shows each status of the service, and what the demo found."""

    def show(self, status: dict[str, Any]) -> None:
        """Show one status of the service."""
        self.update(path_picture(status), status["state"], f"{status['state']}: {status['reason']}")

    def conclude(self, facts: dict[str, Any]) -> None:
        """Print what the demo found."""
        console = self.console
        if facts["state"] != "READY":
            console.print(f"[bold red]{facts['state']}[/]: {facts['reason']}; logs in {facts['paths']['logs']}")
            return
        console.print(terms_table(facts))
        console.print(worth_table(facts))
        took = facts["time"]
        console.print(
            f"[bold green]READY[/] · {facts['verdict']} · {took['simulated_s']:.0f} s of block time in "
            f"{took['real_s']:.0f} s ({took['speed']:g} ×) · "
            f"offline from its recording: {'the same to the last bit' if facts['replay_identical'] else 'DIFFERENT'}"
        )
        for name in ("recording", "result", "report", "rest", "turn"):
            console.print(f"  {name:<9} {facts['paths'][name]}", markup=False, highlight=False, soft_wrap=True)


def terms_table(facts: dict[str, Any]) -> Table:
    """Return planted shift, terms by stage, 1σ and what is left, in mg and deg/h."""
    table = Table(title="Terms added to the readings (accelerometers mg, gyros deg/h)", title_justify="left")
    stages = [stage for stage in STAGE_NAMES if stage != "final"]
    for head in ("sensor", "planted", *(STAGE_NAMES[stage] for stage in stages), "1σ", "left"):
        table.add_column(head, justify="left" if head == "sensor" else "right")
    planted, sigma = _face(facts["planted"]), _face(facts["sigma"])
    terms = [_face(facts["terms"][stage]) for stage in stages]
    for index, sensor in enumerate(SENSORS):
        spread, truth = sigma[index], planted[index] or 0.0
        cells = [f"{truth:+.4f}", *(f"{column[index]:+.4f}" for column in terms)]
        cells += ["unbounded" if spread is None else f"{spread:.4f}", f"{(terms[-1][index] or 0.0) - truth:+.4f}"]
        table.add_row(sensor, *cells)
    return table


def worth_table(facts: dict[str, Any]) -> Table:
    """Return the radial navigation error without and with the terms, and the factor between."""
    table = Table(title="Radial navigation error after 300 s, same block, other noise", title_justify="left")
    for head in ("", "without terms, m", "with terms, m", "factor"):
        table.add_column(head, justify="right" if head else "left")
    names = {"rest": "at rest", "turn": "turn of 90° at 1 deg/s, then rest"}
    for trial, error in facts["radial_error_m"].items():
        factor = facts["improvement"][trial]
        table.add_row(names[trial], f"{error['without']:.1f}", f"{error['with']:.1f}", f"{factor:.1f} ×")
    return table


def _face(terms: dict[str, Any]) -> list[float | None]:
    values = [(value, MG_MPS2) for value in terms["f_mps2"]] + [(value, DEG_H_RADPS) for value in terms["g_radps"]]
    return [None if value is None else value / unit for value, unit in values]
