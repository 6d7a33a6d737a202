"""Strapdown integration (Liu et al., sec. 4; Savage 1998)."""

from typing import Final

from ahrs_service.kernel import inlined_kernel, kernel
from ahrs_service.records import Floats
from ahrs_service.rotation import from_rotation_vector, keep_normal, multiply

SIXTH: Final = 1.0 / 6.0
"""Coefficients of the integrals, see below."""
TWELFTH: Final = 1.0 / 12.0
"""See below."""
THIRTIETH: Final = 1.0 / 30.0
"""A product is several times as fast as a division."""


@inlined_kernel
def rotate(
    q: Floats,
    rate_earlier: Floats,
    rate_before: Floats,
    rate: Floats,
    before_s: float,
    dt_s: float,
    is_mean: bool,
) -> None:
    """Turn `q` [4] over `dt_s` by three gyro samples w0, w1, w2 [rad/s], `before_s` w0 to w1.

    The rotation vector is dt w + dt^2 (k1 w1 + k0 w0) x w2. Where a sample is the rate of one
    instant, w is the mean of the parabola through all three: third order, at uneven steps too.
    Where it is the mean since the sample before, w = w2. In the coning term k1 and k0 cancel the
    drift of pure coning to the fifth order of its frequency, the parabola's own error included
    (as Ignagni 1990 does for means). `before_s` = 0, or below a quarter of `dt_s`: without w0.
    """
    recent = oldest = 0.0
    if 4.0 * before_s >= dt_s:
        per_area = dt_s / (before_s * (before_s + dt_s))
        recent = before_s * per_area
        oldest = -SIXTH * dt_s * per_area
    if is_mean:
        oldest, newest = 0.0, 1.0
        cone_before, cone_earlier = recent * (8.0 - 2.0 * recent) * THIRTIETH, -THIRTIETH * recent
    else:
        newest = (3.0 - recent) * SIXTH
        cone_before, cone_earlier = 2.0 / 15.0, -0.05 * recent
    middle = 1.0 - oldest - newest
    a, b, c = rate_earlier, rate_before, rate
    coning = dt_s * dt_s
    u = coning * (cone_before * b[0] + cone_earlier * a[0])
    v = coning * (cone_before * b[1] + cone_earlier * a[1])
    w = coning * (cone_before * b[2] + cone_earlier * a[2])
    x = dt_s * (oldest * a[0] + middle * b[0] + newest * c[0]) + v * c[2] - w * c[1]
    y = dt_s * (oldest * a[1] + middle * b[1] + newest * c[1]) + w * c[0] - u * c[2]
    z = dt_s * (oldest * a[2] + middle * b[2] + newest * c[2]) + u * c[1] - v * c[0]
    multiply(q, from_rotation_vector(x, y, z), q)
    keep_normal(q)


@kernel
def mean_force(
    rate_before: Floats, rate: Floats, force_before: Floats, force: Floats, dt_s: float, out: Floats
) -> None:
    """Mean specific force over an interval, in the body axes at its end, of means of both sensors.

    With a = w dt: f - a x f / 2 + a x (a x f) / 6 is the mean of a force rotating with the body,
    (a0 x f + f0 x a) / 12 sculling (Savage 1998, part 2, two-sample form). All [3]; out may
    not be one of the others.
    """
    x, y, z = dt_s * rate[0], dt_s * rate[1], dt_s * rate[2]
    # a x f, and what is crossed with a once more: -f / 2 + a x f / 6 - f0 / 12.
    u, v, w = y * force[2] - z * force[1], z * force[0] - x * force[2], x * force[1] - y * force[0]
    u = SIXTH * u - 0.5 * force[0] - TWELFTH * force_before[0]
    v = SIXTH * v - 0.5 * force[1] - TWELFTH * force_before[1]
    w = SIXTH * w - 0.5 * force[2] - TWELFTH * force_before[2]
    share = TWELFTH * dt_s
    a, b, c = share * rate_before[0], share * rate_before[1], share * rate_before[2]
    out[0] = force[0] + y * w - z * v + b * force[2] - c * force[1]
    out[1] = force[1] + z * u - x * w + c * force[0] - a * force[2]
    out[2] = force[2] + x * v - y * u + a * force[1] - b * force[0]
