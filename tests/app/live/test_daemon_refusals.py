"""What the daemon cannot open or write: refused with a reason, or reported and done without."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ahrs_service.errors import ConfigError, LinkOpenError
from ahrs_service.links.mavlink.signing import Signer, key_from_text
from ahrs_service.settings import LinkSettings, Settings, ViewerSettings
from tests.live import names, recorded_in


def test_what_cannot_be_opened_ends_the_service_with_a_reason(
    live: SimpleNamespace, tmp_path: Path
) -> None:
    async def scenario() -> None:
        holder = await live.Vehicle("tcp", tmp_path).prepare()
        port = int(holder.uri.rpartition(":")[2])
        in_use = LinkSettings(uri=f"tcpin:127.0.0.1:{port}")
        with pytest.raises(LinkOpenError, match="cannot listen"):
            async with live.Served(Settings(link=in_use)):
                pass
        loopback = LinkSettings(uri="udpin:127.0.0.1:0")
        with pytest.raises(ConfigError, match=f"port {port}"):
            async with live.Served(Settings(link=loopback, viewer=ViewerSettings(port=port))):
                pass
        viewer = ViewerSettings(rrd=str(tmp_path / "missing" / "x.rrd"))
        with pytest.raises(ConfigError, match="cannot write"):
            async with live.Served(Settings(link=loopback, viewer=viewer)):
                pass
        await holder.close()

    asyncio.run(scenario())


def test_a_disk_that_takes_no_recording_costs_the_recording_alone(
    live: SimpleNamespace, flight_frames: list[bytes], tmp_path: Path
) -> None:
    """The folder is a file, so not even root can write there; the flight continues."""
    (tmp_path / "flights").write_text("no folder")

    async def scenario() -> Any:
        settings = recorded_in(tmp_path / "flights" / "in")
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            await live.fly(served, vehicle, flight_frames[:500])
            await served.until(lambda: "ATTITUDE" in names(vehicle))
        return served

    served = asyncio.run(scenario())
    assert served.daemon.drops()["not_recorded"] == 500
    assert any(level == "warning" and "recording ended" in text for level, text in served.said)


def test_signing_stamps_that_cannot_be_kept_are_reported(
    live: SimpleNamespace,
    flight_frames: list[bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "file"))
    settings = Settings(link=LinkSettings(signing_key="secret"))
    signer = Signer(key_from_text("secret"), 1)

    async def scenario() -> Any:
        async with live.session(settings, "tcp", tmp_path) as (served, vehicle):
            signed = [signer.sign(frame) for frame in flight_frames[:300]]
            await live.fly(served, vehicle, signed)
            await served.until(lambda: "ATTITUDE" in names(vehicle))
        return served

    served = asyncio.run(scenario())
    assert any(level == "warning" and "signing" in text for level, text in served.said)
