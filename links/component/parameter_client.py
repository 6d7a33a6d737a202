"""Reads and sets the parameters of the autopilot at the other end of a link.

Every value asked for is asked for again until it comes, every value set is compared with the one
that the autopilot reports. Source: mavlink.io, Parameter Protocol.
"""

import asyncio
import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from types import TracebackType
from typing import Any, Final, Self

from ahrs_service.adoption import may_adopt
from ahrs_service.errors import ParamError
from ahrs_service.links.component.unit_request import unit_request
from ahrs_service.links.logs.param_files import ParamValue
from ahrs_service.links.logs.parameter_values import (
    ARDUPILOT,
    PX4,
    decode,
    encode,
    param_name,
    rounded,
)
from ahrs_service.links.mavlink.codec import Decoder, Encoder, Signer, dialect
from ahrs_service.links.mavlink.unit_name import unit_name
from ahrs_service.links.transport.link import Link, LinkState, Peer
from ahrs_service.links.transport.registry import open_link

COMPONENT: Final = int(dialect.MAV_COMP_ID_ONBOARD_COMPUTER2)
"""Not that of the service, which may be running at the same time."""
WINDOW: Final = 8
"""Requests under way at once: ArduPilot queues 20, a slow radio takes fewer."""
ATTEMPTS: Final = 8
ANSWER_S: Final = 0.4
GROWTH: Final = 1.3
"""How long the first attempt waits, and by how much longer each further one: 9.5 s in all."""
VEHICLE_S: Final = 10.0
SILENCE_S: Final = 4.0
"""Without a heartbeat for so long the vehicle is gone."""
_HEARTBEAT_S: Final = 1.0
_UNIT_ATTEMPTS: Final = 4
_PX4_UNKNOWN: Final = "unknown param: "
_INVALID: Final = int(dialect.MAV_AUTOPILOT_INVALID)
_NAMES: Final = {ARDUPILOT: "ArduPilot", PX4: "PX4"}


def _patience_s(attempt: int) -> float:
    return ANSWER_S * GROWTH**attempt


class ParameterClient:
    """An open conversation with one autopilot; use it in `async with`.

    `say` receives what the link reports. The first autopilot heard (by HEARTBEAT) is the one,
    or that of `system`; `autopilot`, `system` and `component` are known inside the `async with`,
    and `others` are the systems of further autopilots heard. Every failure is a ParamError that
    says what to do.
    """

    def __init__(
        self,
        uri: str,
        say: Callable[[str], None] = lambda text: None,
        signer: Signer | None = None,
        system: int = 0,
    ) -> None:
        self.uri = uri
        self.autopilot, self.system, self.component = _INVALID, 0, 0
        self.others: set[int] = set()
        self._wanted_system = system
        self._unit: str | None = None
        self._say = say
        self._signer = signer
        self._encoder = Encoder(1, COMPONENT, signer)
        self._link: Link = open_link(uri, self._on_bytes, self._on_state)
        self._decoder = Decoder(signer, datagrams=self._link.is_datagram)
        self._told: dict[str, ParamValue] = {}
        self._errors: dict[str, str] = {}
        self._heard_s = float("-inf")
        self._news = asyncio.Event()
        self._beat: asyncio.Task[None] | None = None

    @property
    def is_chosen(self) -> bool:
        """Whether the system to speak to was given."""
        return self._wanted_system != 0

    @property
    def vehicle(self) -> str:
        """What is at the other end, in words."""
        return f"{_NAMES[self.autopilot]} {self.system}/{self.component}"

    async def __aenter__(self) -> Self:
        """Open the link and wait for an autopilot."""
        try:
            await self._link.start()
            self._beat = asyncio.create_task(self._keep_beating())
            await self._meet()
        except BaseException:
            await self._close()
            raise
        return self

    async def _meet(self) -> None:
        if not await self._until(lambda: self.system != 0, VEHICLE_S):
            which = f"of system {self._wanted_system} " if self._wanted_system else ""
            raise ParamError(
                f"{self._link.uri}: no heartbeat of an autopilot {which}in {VEHICLE_S:.0f} s; "
                "check that it is switched on, that the other end of the link is right, and that "
                "no other program holds it"
            )
        if self.autopilot not in _NAMES:
            raise ParamError(
                f"{self._link.uri}: autopilot {self.autopilot} is neither ArduPilot nor PX4, whose "
                "parameters are the ones known here"
            )

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the link."""
        await self._close()

    async def _close(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._beat
        await self._link.close()

    async def _keep_beating(self) -> None:
        heartbeat = dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, _INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
        )
        while True:
            if self.system or self._link.calls_first:
                self._send(heartbeat)
            await asyncio.sleep(_HEARTBEAT_S)

    def _send(self, message: Any) -> None:
        self._link.send(self._encoder.pack(message))

    def _on_state(self, state: LinkState, why: str) -> None:
        self._say(why)
        if state is LinkState.UP:
            self._decoder.restart()

    def _on_bytes(self, data: bytes, received_us: int, peer: Peer) -> None:
        for message, _ in self._decoder.feed(data):
            sender = (message.get_srcSystem(), message.get_srcComponent())
            if message.get_type() == "HEARTBEAT" and message.autopilot != _INVALID:
                self._heard_autopilot(message, sender)
            if sender == (self.system, self.component):
                self._link.confirm(peer)
                self._take(message)
        self._news.set()

    def _heard_autopilot(self, message: Any, sender: tuple[int, int]) -> None:
        autopilot = int(message.autopilot)
        if self.system == 0 and may_adopt(*sender, autopilot, self._wanted_system, 0):
            self.autopilot = autopilot
            self.system, self.component = sender
            self._encoder = Encoder(self.system, COMPONENT, self._signer)
        elif sender[0] != self.system:
            self.others.add(sender[0])

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._heard_s = asyncio.get_running_loop().time()
        elif kind == "PARAM_VALUE":
            name = param_name(message.param_id)
            self._told[name] = decode(message.param_value, message.param_type, self.autopilot)
        elif kind == "AUTOPILOT_VERSION":
            self._unit = unit_name(message.uid, bytes(message.uid2))
        elif kind == "PARAM_ERROR" and message.target_component in (0, COMPONENT):
            codes = dialect.enums["MAV_PARAM_ERROR"]
            text = codes[message.error].name if message.error in codes else str(message.error)
            self._errors[param_name(message.param_id)] = text.removeprefix("MAV_PARAM_ERROR_")
        elif kind == "STATUSTEXT" and _PX4_UNKNOWN in message.text:
            self._errors[message.text.rpartition(_PX4_UNKNOWN)[2].strip()] = "DOES_NOT_EXIST"

    async def _until(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Wait until it holds; False if it did not in so many seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not holds():
                    self._news.clear()
                    await self._news.wait()
        return holds()

    async def read(self, names: Iterable[str]) -> dict[str, ParamValue]:
        """Return the values as they are now, in this order; a name that is missing has none.

        ParamError where the vehicle fell silent: then nothing is known of the rest.
        """
        wanted = list(dict.fromkeys(names))
        for name in wanted:
            self._told.pop(name, None)
            self._errors.pop(name, None)
        for attempt in range(ATTEMPTS):
            missing = self._missing(wanted)
            for start in range(0, len(missing), WINDOW):
                await self._ask(missing[start : start + WINDOW], _patience_s(attempt))
        missing = self._missing(wanted)
        if missing and not await self.is_alive():
            raise ParamError(
                f"{self._link.uri}: the vehicle fell silent before it sent {missing[0]}; check the "
                "link and run the command again"
            )
        return {name: self._told[name] for name in wanted if name in self._told}

    async def _ask(self, names: list[str], seconds: float) -> None:
        for name in names:
            self._send(
                dialect.MAVLink_param_request_read_message(
                    self.system, self.component, name.encode(), -1
                )
            )
        await self._until(lambda: not self._missing(names), seconds)

    def _missing(self, names: list[str]) -> list[str]:
        return [name for name in names if name not in self._told and name not in self._errors]

    async def write(self, name: str, value: ParamValue) -> ParamValue:
        """Set one parameter and return the value that the autopilot then reports.

        That may differ from what was asked: the autopilot refused or clamped it. ParamError where
        no answer comes.
        """
        wanted = rounded(value)
        message = dialect.MAVLink_param_set_message(
            self.system,
            self.component,
            name.encode(),
            encode(name, value, self.autopilot),
            value.type,
        )
        self._told.pop(name, None)
        self._errors.pop(name, None)
        for attempt in range(ATTEMPTS):
            self._send(message)
            # An answer to an earlier request may still be under way: only the wanted value ends it.
            is_set = partial(self._is_set, name, wanted)
            if await self._until(is_set, _patience_s(attempt)):
                break
            if name in self._told:
                await self._ask_anew(name, _patience_s(attempt))
                if attempt and self._told.get(name) != wanted:
                    break
        if name in self._errors:
            raise ParamError(f"{name}: refused by the autopilot: {self._errors[name]}")
        if name not in self._told:
            raise ParamError(f"{name} = {value.text}: no answer to {ATTEMPTS} PARAM_SET")
        return self._told[name]

    def _is_set(self, name: str, wanted: ParamValue) -> bool:
        return self._told.get(name) == wanted or name in self._errors

    async def _ask_anew(self, name: str, seconds: float) -> None:
        del self._told[name]
        await self._ask([name], seconds)

    async def unit(self) -> str:
        """Return the number of the autopilot's board, "" where it is not reported."""
        for attempt in range(_UNIT_ATTEMPTS):
            if self._unit is None:
                self._send(unit_request(self.system, self.component))
                await self._until(lambda: self._unit is not None, _patience_s(attempt))
        return self._unit or ""

    async def is_alive(self) -> bool:
        """Wait for the vehicle's next heartbeat, but not long."""
        since_s = asyncio.get_running_loop().time()
        return await self._until(lambda: self._heard_s >= since_s, SILENCE_S)
