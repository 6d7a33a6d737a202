"""Hosts and ports as link URIs write them."""

import asyncio
import socket
from typing import Any

from ahrs_service.errors import LinkOpenError, UriError


def host_and_port(uri: str, rest: str, default_host: str | None) -> tuple[str, int]:
    """Split `HOST:PORT` of a URI, an IPv6 host in brackets; an empty host means the default."""
    host, colon, port_text = rest.rpartition(":")
    if not colon or not port_text.isascii() or not port_text.isdigit():
        raise UriError(f"{uri!r}: expected HOST:PORT after the scheme, e.g. 127.0.0.1:14550")
    port = int(port_text)
    lowest = 1 if default_host is None else 0
    if not lowest <= port <= 65535:
        raise UriError(f"{uri!r}: port {port} is not between {lowest} and 65535")
    if host.startswith("["):
        if not host.endswith("]"):
            raise UriError(f"{uri!r}: an IPv6 host is written [::1]:14550")
        host = host[1:-1]
    elif ":" in host:
        raise UriError(f"{uri!r}: write an IPv6 host in brackets, [::1]:14550")
    if not host:
        if default_host is None:
            raise UriError(f"{uri!r}: the host to send to is missing")
        host = default_host
    if any(character in host for character in "/ \t\0"):
        raise UriError(f"{uri!r}: {host!r} is not a host; write scheme:HOST:PORT without '//'")
    return host, port


def place(address: Any) -> str:
    """Write a socket address as HOST:PORT, an IPv6 host in brackets."""
    host, port = str(address[0]), address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


async def resolve(uri: str, host: str, port: int, kind: socket.SocketKind) -> tuple[int, Any]:
    """Return the address family and socket address of a host; LinkOpenError where there is none."""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=kind)
    except (socket.gaierror, UnicodeError) as error:
        raise LinkOpenError(f"{uri}: no host {host!r} ({error}); check the name") from error
    return found[0][0], found[0][4]


def listening_error(uri: str, error: OSError) -> LinkOpenError:
    """Say what to do about an address that cannot be bound."""
    why = error.strerror or str(error)
    return LinkOpenError(f"{uri}: cannot listen ({why}); choose another port or host, or end "
                         "the program that holds it")  # fmt: skip
