"""Time of the estimator's kernels per sample, next to VQF's C++ in the same run.

Run: python tests/benchmarks/kernel_speed.py [--rates 50 200 1000] [--samples 60000] [--repeats 7]

A simulated flight gives the samples at each rate. All times are CPU time of the one thread, which
other programs disturb least. Batch: one call over all samples, median of the repeats [ns per
sample], all contenders in turn in each repeat. Step: one Python call for one sample [us], as a
live loop makes it. "everything" has magnetometer, airspeed and velocity in every sample, "six
axes" has none.
"""

import argparse
import gc
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import vqf
from peers import flu_from_frd
from rich.console import Console
from rich.table import Table

from ahrs_service import pipeline
from ahrs_service.records import ESTIMATE_DTYPE, SAMPLE_DTYPE, Airframe, ImuSource, Rows, empty
from ahrs_service.sensor.parameters import Calibration, coefficients
from ahrs_service.settings import Settings
from ahrs_service.simulation.scenario import make_flight

STEPS = 20_000
MODES = ("velocity", "gated")


def flight_samples(count: int, rate_hz: float, everything: bool) -> Rows:
    """Samples [N] of a simulated flight."""
    rows = make_flight("flight", count / rate_hz, 1, rate_hz).rows[:count]
    samples = empty(SAMPLE_DTYPE, len(rows))
    samples["time_ns"] = samples["received_ns"] = np.rint(rows["time_s"] * 1e9)
    samples["gyro_rad_s"], samples["accel_m_s2"] = rows["gyro_rad_s"], rows["accel_m_s2"]
    samples["source"], samples["airframe"] = ImuSource.HIGHRES_IMU, Airframe.FIXED_WING
    if everything:
        samples["mag_ut"] = rows["mag_ut"]
        samples["airspeed_m_s"] = rows["airspeed_m_s"]
        samples["velocity_ned_m_s"] = rows["velocity_ned_m_s"]
    return samples


def _ours(mode: str) -> tuple[Rows, Rows, Rows]:
    settings = Settings()
    settings = replace(settings, fusion=replace(settings.fusion, mode=mode))
    return (
        pipeline.parameters(settings),
        coefficients(Calibration.ideal()),
        pipeline.new_state(),
    )


def batch_calls(count: int, rate_hz: float) -> dict[str, Callable[[], Any]]:
    """One call over all samples, by contender."""
    calls: dict[str, Callable[[], Any]] = {}
    estimates = empty(ESTIMATE_DTYPE, count)
    for everything in (True, False):
        samples = flight_samples(count, rate_hz, everything)
        what = "everything" if everything else "six axes"
        for mode in MODES:

            def ours(mode: str = mode, samples: Rows = samples) -> None:
                pipeline.batch(*_ours(mode), samples, estimates)

            calls[f"ours {mode}, {what}"] = ours
        gyr, acc = (flu_from_frd(samples[name]) for name in ("gyro_rad_s", "accel_m_s2"))
        mag = flu_from_frd(samples["mag_ut"]) if everything else None
        axes = "nine axes" if everything else "six axes"
        for name, kind in (("VQF", vqf.VQF), ("BasicVQF", vqf.BasicVQF)):

            def theirs(kind: Any = kind, gyr: Any = gyr, acc: Any = acc, mag: Any = mag) -> None:
                kind(1.0 / rate_hz).updateBatch(gyr, acc, mag)

            calls[f"{name} C++, {axes}"] = theirs
    return calls


def step_calls(rate_hz: float) -> dict[str, Callable[[], Any]]:
    """`STEPS` calls of one sample each, by contender; what a caller prepares once is prepared."""
    samples = flight_samples(STEPS, rate_hz, everything=True)
    single = [samples[n : n + 1] for n in range(STEPS)]
    estimate = empty(ESTIMATE_DTYPE)
    gyr, acc, mag = (
        list(flu_from_frd(samples[name])) for name in ("gyro_rad_s", "accel_m_s2", "mag_ut")
    )
    calls: dict[str, Callable[[], Any]] = {}
    for mode in MODES:

        def ours(mode: str = mode) -> None:
            parameters, ideal, state = _ours(mode)
            step = pipeline.step
            for sample in single:
                step(parameters, ideal, state, sample, estimate)

        calls[f"ours {mode}, everything"] = ours
    for name, kind in (("VQF", vqf.VQF), ("BasicVQF", vqf.BasicVQF)):

        def theirs(kind: Any = kind) -> None:
            update = kind(1.0 / rate_hz).update
            for rate, force, field in zip(gyr, acc, mag, strict=True):
                update(rate, force, field)

        calls[f"{name} C++, nine axes"] = theirs
    return calls


def medians(calls: dict[str, Callable[[], Any]], repeats: int, count: int) -> dict[str, float]:
    """Median time per sample [s]; the contenders take turns, each once unmeasured before."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    gc.collect()
    gc.disable()
    for _ in range(repeats):
        for name, call in calls.items():
            begin = time.thread_time()
            call()
            times[name].append((time.thread_time() - begin) / count)
    gc.enable()
    return {name: statistics.median(each) for name, each in times.items()}


def main() -> int:
    """Run all and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rates", nargs="+", type=float, default=[50.0, 200.0, 1000.0])
    parser.add_argument("--samples", type=int, default=60_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    batch = {
        rate: medians(batch_calls(args.samples, rate), args.repeats, args.samples)
        for rate in args.rates
    }
    step = medians(step_calls(args.rates[-1]), args.repeats, STEPS)
    out = Console(width=100)
    first = Table(title="Batch [ns per sample]", title_justify="left", show_edge=False)
    first.add_column("")
    for rate in args.rates:
        first.add_column(f"{rate:g} Hz", justify="right")
    for name in batch[args.rates[0]]:
        first.add_row(name, *(f"{1e9 * batch[rate][name]:.0f}" for rate in args.rates))
    out.print(first)
    second = Table(title="\nOne Python call [us]", title_justify="left", show_edge=False)
    second.add_column("")
    second.add_column(f"{args.rates[-1]:g} Hz", justify="right")
    for name, seconds in step.items():
        second.add_row(name, f"{1e6 * seconds:.2f}")
    out.print(second)
    hour_s = batch[args.rates[-1]]["ours velocity, everything"] * args.rates[-1] * 3600.0
    out.print(f"\nOne hour at {args.rates[-1]:g} Hz: {hour_s:.2f} s of kernel time")
    if args.json is not None:
        plain = {"batch_s": {f"{rate:g}": batch[rate] for rate in args.rates}, "step_s": step}
        args.json.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
