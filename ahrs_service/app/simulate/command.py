"""Fly the simulated autopilot over a link in real time, or write its flight to a .tlog.

ahrs-service simulate --link udpout:127.0.0.1:14550
ahrs-service simulate --scenario circling --tlog circling.tlog
ahrs-service simulate --script configs/flights/warm_up_and_turns.toml --tlog mine.tlog
ahrs-service simulate --from flight.bin --twin configs/twins/small_autopilot.toml --tlog sim.tlog
"""

import argparse
import asyncio
import contextlib
import json
import math
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.markup import escape

from ahrs_service.app import intake_choice
from ahrs_service.app.files import toml_file, twin_file
from ahrs_service.app.options import not_negative, positive
from ahrs_service.app.simulate.retrace_recording import flight_along
from ahrs_service.errors import ConfigError, LinkError
from ahrs_service.links.logs.tlog import tlog_record
from ahrs_service.links.mavlink.codec import Decoder
from ahrs_service.links.simulated.autopilot import DEFAULT_RATES_HZ, SimulatedAutopilot
from ahrs_service.links.simulated.autopilot_messages import UNIX_START_US
from ahrs_service.links.transport.link import Link, LinkState, Peer
from ahrs_service.links.transport.registry import open_link
from ahrs_service.simulation.imu import Imu, consumer_grade
from ahrs_service.simulation.scenario import (
    FASTEST_HZ,
    SCENARIOS,
    Flight,
    fly_scenario,
    make_flight,
)
from ahrs_service.simulation.script import Script

RECORDED_RATES_HZ: Final[Mapping[str, float]] = {
    **DEFAULT_RATES_HZ,
    "HIGHRES_IMU": 200.0,
    "RAW_IMU": 50.0,
    "SIM_STATE": 50.0,
    "SCALED_IMU": 10.0,
    "ATTITUDE": 50.0,
    "ATTITUDE_QUATERNION": 10.0,
    "LOCAL_POSITION_NED": 10.0,
    "VFR_HUD": 10.0,
    "GPS_RAW_INT": 5.0,
    "SCALED_PRESSURE": 5.0,
    "VIBRATION": 2.0,
    "BATTERY_STATUS": 2.0,
}
"""Messages of a flight written to a file [Hz]: those the service requests, and the truth."""

DEFAULT_SECONDS: Final = 60.0
EXIT_DONE: Final = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service simulate`."""
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--link",
        metavar="URI",
        help="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, serial:DEV:BAUD",
    )
    where.add_argument(
        "--tlog", type=Path, metavar="OUT", help="write the flight here instead, unpaced"
    )
    about = "; ".join(f"{name}: {scenario.text}" for name, scenario in SCENARIOS.items())
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--scenario", default="flight", metavar="NAME", help=about)
    what.add_argument(
        "--script", type=Path, metavar="FILE.toml", help="fly these phases, see configs/flights/"
    )
    what.add_argument(
        "--from",
        dest="recording",
        type=Path,
        metavar="RECORDING",
        help="fly along the reference of a .tlog, .bin or .ulg: its attitude and velocity",
    )
    intake_choice.add_arguments(parser)
    parser.add_argument(
        "--twin",
        type=Path,
        metavar="TWIN.toml",
        help="the sensor on board and the effects on it, see configs/twins/; without it the "
        "scenario's sensor; along a recording, an ideal one",
    )
    parser.add_argument(
        "--seconds", type=positive, help="length of a scenario's flight (default: 60)"
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed of flight (default: 1)")
    parser.add_argument(
        "--rate",
        type=positive,
        default=400.0,
        metavar="HZ",
        help=f"the autopilot's loop, to {FASTEST_HZ:g}; it grants messages at 0.8 of it "
        "(default: 400)",
    )
    parser.add_argument(
        "--speed", type=positive, default=1.0, metavar="FACTOR", help="of real time (default: 1)"
    )
    parser.add_argument(
        "--truth",
        type=not_negative,
        default=50.0,
        metavar="HZ",
        help="how often RAW_IMU and its SIM_STATE are sent without request (0: never; default: 50)",
    )
    parser.add_argument("--json", action="store_true", help="end with one line of JSON on stdout")


def write_tlog(path: Path, flight: Flight, rates_hz: Mapping[str, float]) -> int:
    """Write a flight as a .tlog, as fast as possible, and return its number of frames.

    The same flight and rates give the same bytes.
    """
    autopilot = SimulatedAutopilot(flight.rows, flight.rate_hz, rates_hz)
    frames = 0
    try:
        with path.open("wb") as file:
            while (now_s := autopilot.next_due()) < math.inf:
                # A .tlog keeps a link number in the two low bits of its stamp.
                stamp_us = (UNIX_START_US + round(now_s * 1e6)) & ~3
                due = autopilot.due(now_s)
                file.write(b"".join(tlog_record(stamp_us, frame) for frame in due))
                frames += len(due)
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror}; give a file in a folder that exists") from None
    return frames


class LinkFlight:
    """A flight over a link: sends the messages that are due and answers those received."""

    def __init__(self, autopilot: SimulatedAutopilot, uri: str, speed: float, out: Console) -> None:
        self.flown_s = 0.0
        self._autopilot = autopilot
        self._speed = speed
        self._out = out
        self._up = asyncio.Event()
        self._begin_s = math.nan
        self.link: Link = open_link(uri, self._on_bytes, self._on_state)
        self._decoder = Decoder(datagrams=self.link.is_datagram)

    def _on_state(self, state: LinkState, why: str) -> None:
        self._out.print(escape(why), highlight=False, soft_wrap=True)
        if state is LinkState.UP:
            self._up.set()

    def _on_bytes(self, data: bytes, received_us: int, peer: Peer) -> None:
        for message, _ in self._decoder.feed(data):
            self.link.confirm(peer)
            for frame in self._autopilot.on_message(message, self._now_s()):
                self.link.send(frame)

    def _now_s(self) -> float:
        if math.isnan(self._begin_s):
            return 0.0
        return (asyncio.get_running_loop().time() - self._begin_s) * self._speed

    async def fly(self) -> None:
        """Wait for the link, then fly to the end; cancelling it ends the flight early."""
        try:
            await self.link.start()
            await self._up.wait()
            self._begin_s = asyncio.get_running_loop().time()
            while (due_s := self._autopilot.next_due()) < math.inf:
                await asyncio.sleep(max(0.0, (due_s - self._now_s()) / self._speed))
                for frame in self._autopilot.due(self._now_s()):
                    self.link.send(frame)
        finally:
            self.flown_s = min(self._now_s(), self._autopilot.duration_s)
            await self.link.close()


async def _fly(autopilot: SimulatedAutopilot, args: argparse.Namespace, out: Console) -> LinkFlight:
    flight = LinkFlight(autopilot, args.link, args.speed, out)
    task = asyncio.create_task(flight.fly())
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task
    return flight


def _rates(args: argparse.Namespace) -> dict[str, float]:
    if args.tlog is not None:
        return dict(RECORDED_RATES_HZ)
    return {**DEFAULT_RATES_HZ, "RAW_IMU": args.truth, "SIM_STATE": args.truth}


def _flight(args: argparse.Namespace, out: Console) -> Flight:
    """Return the requested flight; ValueError or ConfigError where it cannot be flown."""
    imu = None if args.twin is None else twin_file.read(args.twin)
    if args.recording is not None:
        flight, notes = flight_along(
            args.recording, imu or Imu(), args.rate, args.seed, intake_choice.asked_intake(args)
        )
        for note in notes:
            out.print(escape(note), highlight=False, soft_wrap=True)
        return flight
    if args.script is None:
        seconds = args.seconds or DEFAULT_SECONDS
        return make_flight(args.scenario, seconds, args.seed, args.rate, imu)
    script = toml_file.read_as(args.script, Script)
    scenario = script.scenario(imu or consumer_grade())
    seconds = args.seconds or script.seconds
    return fly_scenario(args.script.stem, scenario, seconds, args.seed, args.rate)


def run(args: argparse.Namespace) -> int:
    """Fly or write the flight; return the exit code."""
    out = Console(stderr=True)
    try:
        flight = _flight(args, out)
        autopilot = SimulatedAutopilot(flight.rows, flight.rate_hz, _rates(args))
    except ValueError as error:
        raise ConfigError(str(error)) from None
    report: dict[str, Any] = {"scenario": flight.scenario, "seed": flight.seed}
    if args.tlog is not None:
        frames = write_tlog(args.tlog, flight, _rates(args))
        report |= {"tlog": str(args.tlog), "seconds": autopilot.duration_s, "frames": frames}
        out.print(f"{escape(str(args.tlog))}: {frames} frames", highlight=False, soft_wrap=True)
    else:
        flown = asyncio.run(_fly(autopilot, args, out))
        counts = autopilot.counts
        report |= {
            "seconds": round(flown.flown_s, 3),
            "sent": dict(counts.sent),
            "not_sent": flown.link.counts.send_failures,
            "attitudes_received": dict(counts.received),
            "commands": dict(counts.commands),
        }
        received = ", ".join(f"{count} {name}" for name, count in counts.received.items())
        out.print(
            f"{sum(counts.sent.values())} messages sent in {flown.flown_s:.1f} s, "
            f"received back: {received or 'no attitude'}",
            highlight=False,
        )
    if args.json:
        print(json.dumps(report), flush=True)
    return EXIT_DONE
