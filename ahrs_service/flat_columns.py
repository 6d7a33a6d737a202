"""Records as flat columns of equal length: what a DataFrame, a CSV or a Parquet file takes."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ahrs_service.records import Rows
from ahrs_service.rotation import euler_columns

_NED: Final = ("north", "east", "down")
_AXES: Final = {
    "ned_from_body": "wxyz",
    "attitude_sigma_rad": _NED,
    "velocity_ned_m_s": _NED,
}
_BODY: Final = "xyz"


def as_columns(rows: Rows) -> dict[str, npt.NDArray[Any]]:
    """Return the fields of `rows` [N], of any dtype of ahrs_service.records, as columns [N].

    A vector becomes one column per axis: `rate_rad_s` [3] is `rate_rad_s_x`, `_y`, `_z`. Estimates
    also get `roll_rad`, `pitch_rad` and `yaw_rad`. pandas.DataFrame and polars.DataFrame take the
    result as it is.

    >>> from ahrs_service import Estimator, as_columns, read_recording
    >>> recording = read_recording("flight.tlog")
    >>> columns = as_columns(Estimator().take(recording.readings))
    >>> [name for name in columns if name.startswith("ned_from_body")]
    ['ned_from_body_w', 'ned_from_body_x', 'ned_from_body_y', 'ned_from_body_z']
    >>> len(columns["roll_rad"]) == len(columns["time_ns"])
    True
    """
    columns: dict[str, npt.NDArray[Any]] = {}
    for name in rows.dtype.names or ():
        if name == "reserved":
            continue
        values, axes = rows[name], _AXES.get(name, _BODY)
        for place in np.ndindex(values.shape[1:]):
            suffix = "".join(axes[i] for i in place)
            column = values[(slice(None), *place)]
            columns[f"{name}_{suffix}" if suffix else name] = np.ascontiguousarray(column)
    if "ned_from_body" in (rows.dtype.names or ()):
        angles = euler_columns(rows["ned_from_body"])
        for i, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad")):
            columns[name] = np.ascontiguousarray(angles[:, i])
    return columns
