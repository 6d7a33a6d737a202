"""Motion of a body that the air pushes about: the force that its accelerometer shows.

Along a body axis where the air resists, with T [s] and an unsteady air n [m/s],

    f = f0 - (v - n) / T,    dv/dt = f + g - w x v

f0 = -g along z, else 0 (fusion.motion has the same); along the others the velocity is as commanded.
"""

from typing import Final

import numpy as np

from ahrs_service.constants import STANDARD_GRAVITY_M_S2
from ahrs_service.kernel import kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, multiply

SETTLE_S: Final = 0.3
"""How soon a command, such as that of wheels on the ground, takes over from the air [s]."""


@kernel
def pushed_force(
    command_m_s: Floats,
    air_m_s: Floats,
    drag_s: Floats,
    rate_rad_s: Floats,
    gravity_m_s2: Floats,
    dt_s: float,
) -> Floats:
    """Return the specific force [N, 3] [m/s^2] in body axes, by steps of `dt_s` [s].

    All are [N, 3] in body axes: the commanded velocity, the unsteady air n, T where the air resists
    and 0 where the command holds, rate and gravity. A step errs by the order of dt / T.
    """
    force = np.empty(command_m_s.shape)
    velocity, slope = command_m_s[0].copy(), np.zeros(3)
    last = len(force) - 1
    for n in range(len(force)):
        rate = rate_rad_s[n]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turned = rate[j] * velocity[k] - rate[k] * velocity[j]
            if drag_s[n, i] > 0.0:
                level = -STANDARD_GRAVITY_M_S2 if i == 2 else 0.0
                force[n, i] = level - (velocity[i] - air_m_s[n, i]) / drag_s[n, i]
            else:
                change = (command_m_s[min(n + 1, last), i] - command_m_s[n, i]) / dt_s
                change -= (velocity[i] - command_m_s[n, i]) / SETTLE_S
                force[n, i] = change + turned - gravity_m_s2[n, i]
            slope[i] = force[n, i] + gravity_m_s2[n, i] - turned
        for i in range(3):
            velocity[i] += slope[i] * dt_s
    return force


@kernel
def attitude_of_rate(rate_rad_s: Floats, start: Floats, dt_s: float) -> Floats:
    """Return the attitudes [N, 4], from `start` [4] on, of rates [N, 3] that each hold a step."""
    out = np.empty((len(rate_rad_s), 4))
    out[0] = start
    for n in range(len(out) - 1):
        x, y, z = rate_rad_s[n] * dt_s
        multiply(out[n], from_rotation_vector(x, y, z), out[n + 1])
    return out
