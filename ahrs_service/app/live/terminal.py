"""The live table and the log lines of the terminal."""

import contextlib
import math
from typing import Final

from rich.console import Console, Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ahrs_service.app.live.daemon import Daemon
from ahrs_service.app.statistics import gate_text
from ahrs_service.health import Health
from ahrs_service.records import Flag, ImuSource, Phase, Record
from ahrs_service.rotation import euler_columns

_COLOURS: Final = {"info": "cyan", "warning": "yellow", "error": "bold red"}
_HEALTH: Final = {Health.GOOD: "bold green", Health.DEGRADED: "yellow", Health.ALIGNING: "cyan"}


class TerminalLog:
    """Prints log lines with their level in colour; keeps the last for the live table."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __call__(self, level: str, text: str) -> None:
        """Print one line."""
        line = Text(f"{level:>7}  ", style=_COLOURS.get(level, ""))
        line.append(text, style="default")
        # Rich ends the program when nobody reads its output any more; a flight goes on.
        with contextlib.suppress(SystemExit, OSError):
            self._console.print(line, soft_wrap=True)


def _grid(*columns: str) -> Table:
    table = Table.grid(padding=(0, 2))
    for justify in columns:
        table.add_column(justify=justify)  # type: ignore[arg-type]
    return table


def _attitude(estimate: Record) -> Table:
    """Roll, pitch, yaw with their 1-sigma, gyro bias and residual per axis."""
    table = _grid("left", "right", "right", "right", "right")
    table.add_row("", "angle", "1-sigma", "gyro bias", "residual", style="dim")
    angles = euler_columns(estimate["ned_from_body"])
    rows = zip(("roll", "pitch", "yaw"), ("x", "y", "z"), range(3), strict=True)
    for angle, axis, i in rows:
        table.add_row(
            angle,
            f"{math.degrees(angles[i]):+8.2f}°",
            f"{math.degrees(estimate['attitude_sigma_rad'][i]):6.2f}°",
            f"{axis} {math.degrees(estimate['gyro_bias_rad_s'][i]):+7.3f} °/s",
            f"{axis} {estimate['residual_m_s2'][i]:+7.2f} m/s²",
        )
    return table


def _gate(estimate: Record) -> Text:
    text = gate_text(int(estimate["phase"]), int(estimate["gate"]))
    open_now = text == "open"
    colour = "green" if open_now else "yellow" if estimate["phase"] == Phase.RUNNING else "cyan"
    line = Text("gate  ")
    line.append(f"● {text}", style=f"bold {colour}")
    line.append(
        f"   |f|-g {estimate['gate_norm_m_s2']:.2f} m/s²"
        f"   |w| {math.degrees(estimate['gate_rate_rad_s']):.1f} °/s"
        f"   |dw/dt| {math.degrees(estimate['gate_angular_acceleration_rad_s2']):.0f} °/s²"
        f"   innovation {estimate['gate_innovation']:.1f} σ",
        style="dim",
    )
    return line


def _rates(daemon: Daemon) -> Table:
    table = _grid("left", "right", "right", "right", "left")
    table.add_row("message", "asked", "granted", "measured", "", style="dim")
    for rate in daemon.component.rates():
        table.add_row(
            rate.name,
            f"{rate.asked_hz:.0f} Hz",
            "-" if rate.granted_hz is None else f"{rate.granted_hz:.0f} Hz",
            f"{rate.measured_hz:.1f} Hz",
            Text(rate.state, style="dim"),
        )
    return table


def _traffic(daemon: Daemon) -> Text:
    session = daemon.session
    counts = daemon.decoder.counts
    damaged = sum(value for name, value in counts.items() if name != "frames")
    line = Text(
        f"{session.estimates} samples, {session.published} attitudes sent, "
        f"{session.not_sent} not sent; latency {_latency(daemon)}; "
        f"{counts['frames']} frames in, {damaged} damaged"
    )
    return line


def _latency(daemon: Daemon) -> str:
    if not daemon.session.published:
        return "-"
    p50, p99, worst = daemon.session.latency.percentiles_ms()
    return f"p50 {p50:.2f} ms, p99 {p99:.2f} ms, max {worst:.2f} ms"


def live_table(daemon: Daemon) -> Panel:
    """Return the table as of now."""
    state = daemon.health.state
    title = Text("ahrs-service  ")
    title.append(state.value, style=_HEALTH.get(state, "bold red"))
    if daemon.health.reasons:
        title.append(f" ({'; '.join(daemon.health.reasons)})", style="yellow")
    parts: list[Table | Text] = []
    estimate = daemon.latest
    if estimate is not None:
        parts += [_attitude(estimate), _gate(estimate), _sensors(estimate)]
    parts += [Text(), _rates(daemon), Text(), _traffic(daemon)]
    return Panel(Group(*parts), title=title, subtitle=daemon.settings.link.uri, title_align="left")


def _sensors(estimate: Record) -> Text:
    temperature = float(estimate["temperature_degc"])
    shown = "none" if math.isnan(temperature) else f"{temperature:.1f} °C"
    flags = int(estimate["flags"])
    names = [str(flag.name).lower().replace("_", " ") for flag in Flag if flag and flags & flag]
    line = Text(f"IMU   {ImuSource(int(estimate['source'])).name}, temperature {shown}")
    if names:
        line.append("   " + ", ".join(names), style="yellow")
    return line


def session_table(daemon: Daemon) -> Table:
    """Return what the session did: time per gate state, rates, latency, what was lost."""
    session = daemon.session
    table = Table(title="session", show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    shares = [f"{share:6.1%}  {text}" for text, share in session.gates.shares().items()]
    table.add_row("time per gate state", "\n".join(shares) or "no estimate")
    if daemon.calibration is not None:
        table.add_row("calibration", daemon.calibration.text().removeprefix("calibration "))
    rates = [
        f"{rate.name}: requested {rate.asked_hz:g}, received {rate.mean_hz:.1f} Hz ({rate.state})"
        for rate in daemon.component.rates()
    ]
    table.add_row("rates", "\n".join(rates))
    table.add_row("latency", _latency(daemon))
    table.add_row("samples", f"{session.estimates}, attitudes sent {session.published}")
    lost = ", ".join(f"{count} {name}" for name, count in daemon.drops().items() if count)
    table.add_row("lost", lost or "nothing")
    return table
