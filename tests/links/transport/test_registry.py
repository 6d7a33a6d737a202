"""URIs: valid ones, errors for the rest; the example configurations."""

import asyncio
import contextlib
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from ahrs_service.errors import UriError
from ahrs_service.links.transport.address import host_and_port, place
from ahrs_service.links.transport.link import Link, LinkState
from ahrs_service.links.transport.registry import SCHEMES, open_link
from ahrs_service.settings import Settings

CONFIGS = Path(__file__).resolve().parents[3] / "configs"


def opened(uri: str) -> Link:
    return open_link(uri, lambda data, us, peer: None, lambda state, why: None)


@pytest.mark.parametrize(
    "uri",
    [
        "udpin::14550",
        "udpin:0.0.0.0:14550",
        "udpout:192.0.2.1:14550",
        "tcp:[fe80::1]:5760",
        "tcpin:localhost:5760",
        "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0:921600",
    ],
)
def test_well_formed_uris_make_a_link_that_is_not_open_yet(uri: str) -> None:
    link = opened(uri)
    assert link.uri == uri
    assert link.state is LinkState.CONNECTING
    assert link.is_datagram == uri.startswith("udp")


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("udp:127.0.0.1:14550", "known: udpin:HOST:PORT, udpout"),
        ("14550", "known: udpin"),
        ("", "known: udpin"),
        ("udpin:14550x", "expected HOST:PORT"),
        ("udpin:127.0.0.1:", "expected HOST:PORT"),
        ("udpin:127.0.0.1:-1", "expected HOST:PORT"),
        ("udpin:127.0.0.1:65536", "port 65536 is not between 0 and 65535"),
        ("tcp:127.0.0.1:0", "port 0 is not between 1 and 65535"),
        ("tcp::5760", "host to send to is missing"),
        ("tcp:::1:5760", "in brackets"),
        ("tcp:[::1:5760", r"written \[::1\]"),
        ("tcp://127.0.0.1:5760", "without '//'"),
        ("serial:/dev/ttyAMA0", "expected serial:DEV:BAUD"),
        ("serial:/dev/ttyAMA0:fast", "expected serial:DEV:BAUD"),
        ("serial:/dev/ttyAMA0:0", "expected serial:DEV:BAUD"),
        ("serial::57600", "expected serial:DEV:BAUD"),
    ],
)
def test_malformed_uris_say_what_is_wrong_with_which_value(uri: str, says: str) -> None:
    with pytest.raises(UriError, match=says) as caught:
        opened(uri)
    assert repr(uri) in str(caught.value)


@given(st.text(max_size=40))
def test_any_text_is_a_link_or_a_uri_error(text: str) -> None:
    for scheme in SCHEMES:
        with contextlib.suppress(UriError):
            assert opened(f"{scheme}:{text}").uri == f"{scheme}:{text}"


@given(st.ip_addresses().map(str), st.integers(1, 65535))
def test_places_are_read_back_as_written(host: str, port: int) -> None:
    assert host_and_port("tcp:", place((host, port)), None) == (host, port)


def test_an_empty_host_listens_on_loopback_alone() -> None:
    async def started() -> str:
        link = opened("udpin::0")
        await link.start()
        uri = link.uri
        await link.close()
        return uri

    assert asyncio.run(started()).startswith("udpin:127.0.0.1:")


@pytest.mark.parametrize("name", ["ardupilot.toml", "px4.toml"])
def test_example_configurations_hold_known_settings_and_a_link(name: str) -> None:
    settings = TypeAdapter(Settings).validate_python(
        tomllib.loads((CONFIGS / name).read_text("utf-8"))
    )
    opened(settings.link.uri)
    assert settings.recorder.directory
