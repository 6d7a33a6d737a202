"""A finding in words: one plain sentence that a pilot understands."""

import numpy as np

from ahrs_service.diagnosis.hypotheses.candidates import Term
from ahrs_service.records import Floats

_SENSORS = {"gyro": "gyro", "accel": "accelerometer", "imu": "IMU"}


def _amount(sizes: Floats) -> str:
    gyro, accel = sizes[:3].max(), sizes[3:].max()
    if accel == 0.0:
        return f"{np.degrees(gyro):.2g} deg/s"
    if gyro == 0.0:
        return f"{accel:.2g} m/s2"
    return f"{np.degrees(gyro):.2g} deg/s and {accel:.2g} m/s2"


def explanation(term: Term, sizes: Floats, alike: tuple[str, ...]) -> str:
    """Return the sentence for a term that adds these rms sizes [6] to the channels."""
    effect = term.effect
    channel = int(np.argmax(sizes / np.array([*3 * [1.0], *3 * [10.0]])))
    axis = "xyz"[channel % 3]
    text = (
        f"The {_SENSORS[effect.triad]} reads wrong by {_amount(sizes)} rms, most on {axis}: "
        f"{effect.title}"
    )
    if len(alike) > 1:
        others = ", ".join(name.replace("_", " ") for name in alike[1:])
        text += f"; this recording cannot tell it from {others}"
    return text + "."
