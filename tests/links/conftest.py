"""A conversation between our component and the simulated autopilot, without a wire."""

from collections import Counter

import pytest

from ahrs_service.links.component.component import Component
from ahrs_service.links.mavlink.codec import Encoder, decode_frame, dialect
from ahrs_service.links.simulated.autopilot import DEFAULT_RATES_HZ, SimulatedAutopilot
from ahrs_service.settings import Settings
from ahrs_service.simulation.scenario import make_flight
from tests.links.messages import heartbeat

LOOP_HZ = 400.0
TICK_S = 0.05


def arrive(message, system=1, component=1):
    """The message as it comes off the wire from this sender."""
    return decode_frame(Encoder(system, component).pack(message))


@pytest.fixture(scope="session")
def arrived():
    return arrive


class Conversation:
    """Component and autopilot tick together; faults are set from outside.

    `deaf` no command reaches the autopilot; `lose_acks` so many answers are lost; `refuse` answers
    SET_MESSAGE_INTERVAL of these messages with this result; `withhold` never arrive. `sent` are
    the messages of the component as they arrive, with their time; `events` its events.
    """

    def __init__(self, rows, settings=None, loop_hz=LOOP_HZ, rates_hz=DEFAULT_RATES_HZ):
        self.component = Component(settings or Settings())
        self.now_s = 1000.0
        self.sent, self.events, self.heard = [], [], Counter()
        self.deaf, self.lose_acks, self.refuse, self.withhold = False, 0, {}, set()
        self.cut = False
        self._rows, self._loop_hz, self._rates_hz = rows, loop_hz, rates_hz
        self._to_us, self._to_autopilot = None, Encoder(1, 191)
        self.boot()

    def boot(self):
        """Restart the autopilot: its clock starts at 0 and all requests are lost."""
        self.autopilot = SimulatedAutopilot(self._rows, self._loop_hz, self._rates_hz)
        self.boot_s = self.now_s

    def run(self, seconds, state="active"):
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += TICK_S
            for frame in self.autopilot.due(self.now_s - self.boot_s):
                self._deliver(decode_frame(frame))
            for message in self.component.tick(self.now_s, state):
                self._send(message)
            self.events += self.component.drain_events()

    def _deliver(self, message):
        name = message.get_type()
        if name == "COMMAND_ACK" and self.lose_acks:
            self.lose_acks -= 1
            return
        if self.cut or name in self.withhold:
            return
        self.heard[name] += 1
        for reply in self.component.on_message(message, self.now_s):
            self._send(reply)

    def _send(self, message):
        frame = self._to_autopilot.pack(message)
        message = decode_frame(frame)
        self.sent.append((self.now_s, message))
        name = message.get_type()
        if self.cut or (self.deaf and name == "COMMAND_LONG"):
            return
        if name == "COMMAND_LONG":
            asked = dialect.mavlink_map[int(message.param1)].msgname
            if asked in self.refuse:
                self._deliver(
                    arrive(
                        dialect.MAVLink_command_ack_message(
                            message.command, self.refuse[asked], 0, 0, 1, 191
                        )
                    )
                )
                return
        for answer in self.autopilot.on_message(message, self.now_s - self.boot_s):
            self._deliver(decode_frame(answer))

    def named(self, name):
        """(time, message) of what the component sent by this name."""
        return [(at_s, message) for at_s, message in self.sent if message.get_type() == name]

    def asked(self, name, since_s=0.0):
        """(time, asked rate [Hz]) of the requests for one message."""
        number = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
        return [
            (at_s, round(1e6 / message.param2))
            for at_s, message in self.named("COMMAND_LONG")
            if message.param1 == number and at_s >= since_s
        ]

    def texts(self, part):
        """Events of the component that contain this text."""
        return [text for _, text in self.events if part in text]


@pytest.fixture(scope="session")
def converse():
    """Function that starts a conversation; the autopilot's flight lasts 200 s."""
    rows = {}

    def start(loop_hz=LOOP_HZ, **options):
        if loop_hz not in rows:
            rows[loop_hz] = make_flight("flight", 200.0, seed=3, rate_hz=loop_hz).rows
        return Conversation(rows[loop_hz], loop_hz=loop_hz, **options)

    return start


@pytest.fixture
def adopted(arrived):
    """Function that makes a component which has adopted 1/1."""

    def make(settings=None):
        component = Component(settings or Settings())
        component.on_message(arrived(heartbeat()), 0.0)
        return component

    return make
