"""Take the picture of the viewer without a screen, from an .rrd file or from a live stream.

Needs software Vulkan (Debian: mesa-vulkan-drivers libvulkan1). Fails if the viewer warned of
anything. Run: python tests/benchmarks/viewer_picture.py flight.rrd --at 90 --out viz/demo.png
"""

import argparse
import io
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

_BINARY = Path(rerun_cli.__file__).parent / "rerun"
_BIND = ("--bind", "127.0.0.1")
_SETTLE_S = 6.0
_NOT_OURS = ("Software rasterizer", "welcome_screen")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _connect(port: int, viewer: subprocess.Popen[bytes]) -> ViewerClient:
    for _ in range(150):
        if viewer.poll() is not None:
            sys.exit(f"the viewer ended with {viewer.returncode}: is software Vulkan installed?")
        try:
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        except Exception:
            time.sleep(0.2)
    sys.exit("the viewer did not answer within 30 s")


def _still(client: ViewerClient) -> Image.Image:
    """Shoot until two pictures in a row are alike, or after 20 shots of a moving stream."""
    last = b""
    for _ in range(20):
        shot = client.take_screenshot()
        picture = Image.open(io.BytesIO(shot)).convert("RGB")
        if picture.tobytes() == last:
            break
        last = picture.tobytes()
        time.sleep(0.3)
    return picture


def _complaints(client: ViewerClient) -> list[str]:
    entries = [
        entry for entry in client.get_logs() if str(entry.level).upper() in ("WARN", "ERROR")
    ]
    return [str(e) for e in entries if not any(word in str(e) for word in _NOT_OURS)]


def take(source: str, at_s: float | None, size: str) -> tuple[Image.Image, list[str]]:
    """Return the picture of `source` at time `at_s`, and what the viewer complained about."""
    port = _free_port()
    with tempfile.TemporaryDirectory() as home:
        viewer = subprocess.Popen(
            [
                _BINARY,
                "--headless",
                "--window-size",
                size,
                "--bind",
                "127.0.0.1",
                "--port",
                str(port),
            ],
            env={**os.environ, "HOME": home, "XDG_CONFIG_HOME": home},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            client = _connect(port, viewer)
            client.open(source)
            time.sleep(1.0)
            if at_s is not None:
                client.set_time("t", duration=at_s, play_state="paused")
            time.sleep(_SETTLE_S)
            return _still(client), _complaints(client)
        finally:
            viewer.terminate()
            viewer.wait(10)


def main() -> None:
    """Write the picture, in 256 colours so that it stays small."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", help=".rrd file or rerun+http://127.0.0.1:9876/proxy")
    parser.add_argument("--at", type=float, help="time t [s]; a live stream is followed")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", default="1600x1000")
    arguments = parser.parse_args()
    picture, complaints = take(arguments.source, arguments.at, arguments.size)
    picture.quantize(256, dither=Image.Dither.NONE).save(arguments.out, optimize=True)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e3:.0f} kB")
    if complaints:
        sys.exit("the viewer complained:\n" + "\n".join(complaints))


if __name__ == "__main__":
    main()
