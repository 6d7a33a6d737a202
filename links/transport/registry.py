"""Opens a link by its URI; the module of a kind of link is imported when it is first asked for."""

from importlib import import_module
from typing import Final, cast

from ahrs_service.errors import UriError
from ahrs_service.links.transport.link import Link, OnBytes, OnState

SCHEMES: Final = {
    "udpin": ("ahrs_service.links.transport.udp", "UdpInLink", "udpin:HOST:PORT"),
    "udpout": ("ahrs_service.links.transport.udp", "UdpOutLink", "udpout:HOST:PORT"),
    "tcp": ("ahrs_service.links.transport.tcp", "TcpLink", "tcp:HOST:PORT"),
    "tcpin": ("ahrs_service.links.transport.tcp", "TcpInLink", "tcpin:HOST:PORT"),
    "serial": ("ahrs_service.links.transport.serial_port", "SerialLink", "serial:DEV:BAUD"),
}
"""Module, class and form of the URI by scheme."""


def open_link(uri: str, on_bytes: OnBytes, on_state: OnState) -> Link:
    """Return the link that the URI names, not started yet.

    `udpin:` and `tcpin:` listen (an empty HOST is loopback, port 0 any free port), `udpout:` and
    `tcp:` go out to HOST. Both callbacks run in the event loop that `start` ran in.
    """
    scheme, colon, rest = uri.partition(":")
    known = ", ".join(form for _, _, form in SCHEMES.values())
    if not colon or scheme not in SCHEMES:
        raise UriError(f"{uri!r}: no such kind of link {scheme!r}; known: {known}")
    module, name, _ = SCHEMES[scheme]
    return cast(Link, getattr(import_module(module), name)(uri, rest, on_bytes, on_state))
