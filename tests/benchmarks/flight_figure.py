"""Picture of a stretch of one real flight: reference, ours, two peers, errors, and the gate.

Run: python tests/benchmarks/flight_figure.py [--data DIR] [--log NAME] [--from S] [--to S]
                                              [--out viz/flight.png]

All six axes only. The peers are the two best filters on the whole flight (rms of roll and pitch
together), each in its best setting; the numbers in the picture are of the stretch shown. Beneath is
what the gate said about the accelerometer at every sample: open, or each reason against it.
"""

import argparse
import io
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from flight_recordings import LOGS, Flight, read_flight
from flights import estimates_of
from peers import PEERS, PROJECT, SHARED_DATA, require_data

from ahrs_service.attitude_interpolation import at_instants
from ahrs_service.comparison import compare
from ahrs_service.records import Gate, Rows
from ahrs_service.rotation import euler_columns

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from PIL import Image

DOTS_PER_INCH = 160
PALETTE = 128
GAP_S = 0.5
COLOURS = {"reference": "#222222", "ours": "#0a66c2", "first": "#e07a1f", "second": "#4a9c59"}
GATES = {
    "open": (Gate.OPEN, "#2e8b57"),
    "norm": (Gate.NORM, "#c0392b"),
    "rate": (Gate.RATE, "#d98e04"),
    "angular acc.": (Gate.ANGULAR_ACCELERATION, "#8e5ea2"),
    "innovation": (Gate.INNOVATION, "#16789a"),
    "clipped, stale": (Gate.SATURATION | Gate.STALE, "#555555"),
}
"""Rows of the strip, what of the gate they show, and their colour."""


def family(peer: str) -> str:
    """Name of the filter whose setting this is."""
    return peer.removeprefix("Basic").split()[0].lower()


def best_peers(flight: Flight) -> tuple[Rows, dict[str, Rows]]:
    """Ours [N], and the two best filters [N] by name."""
    reference = flight.reference
    sizes: dict[str, tuple[float, str, Rows]] = {}
    for name, rows in estimates_of(flight, ["ours", *PEERS]):
        one = compare(rows, reference.time_ns, reference.ned_from_body, False)
        size = one.roll.rms + one.pitch.rms
        if name == "ours":
            ours = rows
        elif size < sizes.get(family(name), (np.inf,))[0]:
            sizes[family(name)] = (size, name, rows)
    best = sorted(sizes.values(), key=lambda one: one[0])[:2]
    return ours, {name: rows for _, name, rows in best}


class Stretch:
    """Angles [deg] of the stretch, at the instants of the reference."""

    def __init__(self, flight: Flight, start_s: float, stop_s: float) -> None:
        order = np.argsort(flight.reference.time_ns, kind="stable")
        self.time_ns = flight.reference.time_ns[order]
        self.origin_ns = int(flight.samples["time_ns"][0])
        self.t_s = (self.time_ns - self.origin_ns) * 1e-9
        self.shown = (self.t_s >= start_s) & (self.t_s <= stop_s)
        self.after_gap = np.diff(self.t_s, prepend=self.t_s[0]) > GAP_S
        if self.shown.sum() < 10:
            raise SystemExit(f"{flight.name}: no attitude from {start_s:g} to {stop_s:g} s")
        self.q = flight.reference.ned_from_body[order]
        self.reference = np.degrees(euler_columns(self.q))
        # No line is drawn where nothing was measured.
        self.reference[self.after_gap] = np.nan
        self.start_s, self.stop_s = start_s, stop_s

    def angles(self, rows: Rows) -> tuple[Any, Any]:
        """Roll and pitch [M, 2] of an algorithm, NaN where there is none, and their errors."""
        at, found = at_instants(rows, self.time_ns, self.q)
        drawn = found & ~self.after_gap
        angles = np.where(drawn[:, None], np.degrees(euler_columns(at)), np.nan)[:, :2]
        error = (angles - self.reference[:, :2] + 180.0) % 360.0 - 180.0
        return angles[self.shown], error[self.shown]


def draw_angles(axes: Any, stretch: Stretch, algorithms: list[tuple[str, str, Rows]]) -> None:
    """Roll and pitch above, their errors beneath, [deg]."""
    t_s = stretch.t_s[stretch.shown]
    for axis, name in enumerate(("roll", "pitch")):
        above, beneath = axes[axis], axes[2 + axis]
        theirs = _unwrapped(stretch.reference[stretch.shown, axis])
        above.plot(t_s, theirs, color=COLOURS["reference"], lw=2.4, alpha=0.45)
        for label, colour, rows in reversed(algorithms):
            angles, error = stretch.angles(rows)
            width = 1.3 if label == "ours" else 0.9
            rms = float(np.sqrt(np.nanmean(error[:, axis] ** 2)))
            above.plot(t_s, _unwrapped(angles[:, axis]), color=colour, lw=width)
            beneath.plot(t_s, error[:, axis], color=colour, lw=width, label=f"{label}: {rms:.1f}°")
        above.set_ylabel(f"{name} [deg]")
        beneath.set_ylabel(f"{name} error [deg]")
        beneath.axhline(0.0, color="#222222", lw=0.7)
        handles, labels = beneath.get_legend_handles_labels()
        beneath.legend(
            handles[::-1],
            [f"rms {label}" for label in labels[::-1]],
            ncols=3,
            loc="lower left",
            bbox_to_anchor=(0.0, 0.98),
            borderaxespad=0.0,
            frameon=False,
            fontsize=8,
            handlelength=1.4,
            columnspacing=1.4,
        )


def _unwrapped(angle: Any) -> Any:
    """Angles [M] [deg] without a line across the picture where they pass 180."""
    across = np.abs(np.diff(angle, prepend=angle[0])) > 180.0
    return np.where(across, np.nan, angle)


def draw_gate(axes: Axes, stretch: Stretch, ours: Rows) -> None:
    """One row for the open gate and one for every reason, over the samples' time."""
    t_s = (ours["time_ns"] - stretch.origin_ns) * 1e-9
    shown = (t_s >= stretch.start_s) & (t_s <= stretch.stop_s)
    t_s, gate = t_s[shown], ours["gate"][shown]
    for row, (meaning, colour) in enumerate(GATES.values()):
        on = gate == 0 if meaning == Gate.OPEN else (gate & int(meaning)) != 0
        steps = np.diff(t_s, append=t_s[-1])
        steps = np.where(steps < GAP_S, steps, 0.0)
        axes.broken_barh(_joined(t_s[on], steps[on]), (row - 0.42, 0.84), color=colour, lw=0.0)
        share = f"{100.0 * on.mean():.0f} %"
        axes.text(1.005, row, share, transform=axes.get_yaxis_transform(), va="center", fontsize=8)
    axes.set_yticks(range(len(GATES)), list(GATES), fontsize=8)
    axes.set_ylim(len(GATES) - 0.4, -0.6)
    axes.set_ylabel("gate")
    axes.set_xlabel("time since the start of the recording [s]")


def _joined(starts: Any, lengths: Any) -> list[tuple[float, float]]:
    """Bars (start, length) [s] of samples that follow one another, as one each."""
    stops = starts + lengths
    first = np.concatenate([[True], starts[1:] > stops[:-1] + 1e-9])[: len(starts)]
    places = np.flatnonzero(first)
    last = np.append(places[1:], len(starts))[: len(places)] - 1
    return [(a, b - a) for a, b in zip(starts[places], stops[last], strict=True)]


def draw(flight: Flight, start_s: float, stop_s: float, path: Path) -> None:
    """Draw the picture and write it."""
    ours, peers = best_peers(flight)
    stretch = Stretch(flight, start_s, stop_s)
    algorithms = [("ours", COLOURS["ours"], ours)]
    for place, (name, rows) in zip(("first", "second"), peers.items(), strict=True):
        algorithms.append((name, COLOURS[place], rows))
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(
        5, 1, figsize=(9.6, 9.0), sharex=True, height_ratios=(1.5, 1.2, 1.0, 1.0, 0.9)
    )
    draw_angles(axes, stretch, algorithms)
    draw_gate(axes[4], stretch, ours)
    for one in axes:
        one.grid(axis="x" if one is axes[4] else "both", color="#dddddd", lw=0.6)
        one.set_axisbelow(True)
    axes[0].set_xlim(start_s, stop_s)
    lines = [plt.Line2D([], [], color=COLOURS["reference"], lw=2.4, alpha=0.45)]
    lines += [plt.Line2D([], [], color=colour, lw=1.4) for _, colour, _ in algorithms]
    labels = ["reference (autopilot, GPS-aided)", *(label for label, _, _ in algorithms)]
    figure.legend(
        lines, labels, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 0.965), frameon=False
    )
    figure.suptitle(
        f"{flight.name}: a real flight, gyro and accelerometer only", y=0.985, fontsize=11
    )
    figure.align_ylabels(axes)
    figure.subplots_adjust(left=0.115, right=0.945, top=0.93, bottom=0.055, hspace=0.2)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DOTS_PER_INCH)
    plt.close(figure)
    # A palette is a third of the size and looks the same.
    Image.open(drawn).convert("RGB").quantize(PALETTE).save(path, optimize=True)


def main() -> int:
    """Draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=SHARED_DATA / "flights", metavar="DIR")
    parser.add_argument("--log", choices=list(LOGS), default="thor75")
    parser.add_argument("--from", dest="start_s", type=float, default=205.0, metavar="S")
    parser.add_argument("--to", dest="stop_s", type=float, default=355.0, metavar="S")
    parser.add_argument("--out", type=Path, default=PROJECT / "viz" / "flight.png", metavar="PNG")
    args = parser.parse_args()
    data = require_data(args.data, "the flight recordings")
    draw(read_flight(args.log, data / LOGS[args.log]), args.start_s, args.stop_s, args.out)
    print(f"{args.out}: {args.out.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
