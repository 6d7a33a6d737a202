"""Play a recording over a link in real time, as the vehicle that was recorded.

Examples:
  ahrs-service play flight.tlog --link udpout:127.0.0.1:14550
  ahrs-service play flight.tlog --link serial:/dev/ttyUSB0:57600 --speed 4 --loop

"""

import argparse
import asyncio
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ahrs_service.app.options import positive_or_inf
from ahrs_service.links.logs.player import PlayCounts, due_s, play
from ahrs_service.links.logs.tlog import TlogFile, read_tlog
from ahrs_service.links.transport.link import Link, LinkState, Peer
from ahrs_service.links.transport.registry import open_link

EXIT_DONE: Final = 0
EXIT_NOTHING_SENT: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ahrs-service play`."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a .tlog recording")
    parser.add_argument(
        "--link",
        required=True,
        metavar="URI",
        help="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, serial:DEV:BAUD",
    )
    parser.add_argument(
        "--speed",
        type=positive_or_inf,
        default=1.0,
        metavar="FACTOR",
        help="speed over real time; inf: as fast as possible",
    )
    parser.add_argument(
        "--max-gap",
        type=positive_or_inf,
        default=math.inf,
        metavar="SECONDS",
        help="longer gaps of the recording are shortened to this",
    )
    parser.add_argument("--loop", action="store_true", help="start again at the end, without end")


@contextmanager
def _progress(console: Console, name: str, frames: int) -> Iterator[Callable[[int], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(escape(name), total=frames)
        yield lambda done: bar.update(task, completed=done)


async def _serve(args: argparse.Namespace, log: TlogFile, console: Console) -> PlayCounts:
    """Open the link, wait until there is a listener, and play."""
    up = asyncio.Event()

    def on_state(state: LinkState, why: str) -> None:
        console.print(escape(why), highlight=False, soft_wrap=True)
        if state is LinkState.UP:
            up.set()

    def on_bytes(data: bytes, received_us: int, peer: Peer) -> None:
        link.confirm(peer)

    link: Link = open_link(args.link, on_bytes, on_state)
    total = PlayCounts()
    try:
        await link.start()
        await up.wait()
        with _progress(console, args.log.name, len(log.frames)) as progress:
            while True:
                counts = await play(log, link, args.speed, args.max_gap, progress)
                total.sent += counts.sent
                total.lost += counts.lost
                if not args.loop:
                    return total
    finally:
        await link.close()


def run(args: argparse.Namespace) -> int:
    """Play the recording; return 0 if the link took any of it."""
    console = Console(stderr=True)
    log = read_tlog(args.log)
    seconds = due_s(log.frames["received_us"], args.speed, args.max_gap)[-1]
    console.print(f"{args.log.name}: {len(log.frames)} frames, {seconds:.1f} s", highlight=False)
    counts = asyncio.run(_serve(args, log, console))
    lost = f", {counts.lost} lost: the link was down or full" if counts.lost else ""
    console.print(f"{counts.sent} frames sent{lost}", highlight=False)
    return EXIT_DONE if counts.sent else EXIT_NOTHING_SENT
