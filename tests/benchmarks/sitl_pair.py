"""A simulator's recording, and the same with a scale error planted: what `diagnose` says lacks.

Run: python tests/benchmarks/sitl_pair.py [--data DIR] [--seconds S]

Part of ../shared/data/sitl/arduplane_sitl_nominal.tlog is written as it is, and with 1 % of scale
error in the gyro of every HIGHRES_IMU; `diagnose REAL --against SIM` is then run on the two files.
"""

import argparse
import tempfile
from pathlib import Path

from peers import SHARED_DATA, require_data

from ahrs_service.app.cli import main as ahrs_service
from ahrs_service.links.logs.tlog import TlogFile, read_tlog, tlog_record
from ahrs_service.links.mavlink.codec import Encoder, decode_frame

SCALE_ERROR = {"xgyro": 0.012, "ygyro": -0.010, "zgyro": 0.015}
_BEGIN_S = 95.0


def written(path: Path, tlog: TlogFile, seconds: float, scale_error: dict[str, float]) -> None:
    """Write a part of a .tlog, the named fields of HIGHRES_IMU scaled."""
    encoders: dict[tuple[int, int], Encoder] = {}
    begin_us = int(tlog.frames["received_us"][0]) + round(_BEGIN_S * 1e6)
    with path.open("wb") as file:
        for row in tlog.frames:
            stamp_us, begin = int(row["received_us"]) & ~3, int(row["offset"])
            if not begin_us <= stamp_us < begin_us + seconds * 1e6:
                continue
            frame = tlog.data[begin : begin + int(row["length"])].tobytes()
            message = decode_frame(frame)
            if message.get_type() == "HIGHRES_IMU":
                for name, error in scale_error.items():
                    setattr(message, name, getattr(message, name) * (1.0 + error))
                sender = int(row["sysid"]), int(row["compid"])
                frame = encoders.setdefault(sender, Encoder(*sender)).pack(message)
            file.write(tlog_record(stamp_us, frame))


def main() -> int:
    """Write both and diagnose them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_DATA)
    parser.add_argument("--seconds", type=float, default=31.0)
    arguments = parser.parse_args()
    folder = require_data(arguments.data, "the folder sitl")
    tlog = read_tlog(folder / "sitl" / "arduplane_sitl_nominal.tlog")
    with tempfile.TemporaryDirectory() as name:
        real, simulated = Path(name) / "real.tlog", Path(name) / "sim.tlog"
        written(simulated, tlog, arguments.seconds, {})
        written(real, tlog, arguments.seconds, SCALE_ERROR)
        return ahrs_service(["diagnose", str(real), "--against", str(simulated)])


if __name__ == "__main__":
    raise SystemExit(main())
