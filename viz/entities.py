"""Names and colours of everything in the viewer, for the columns and the blueprint alike."""

from typing import Final

TIMELINE: Final = "t"
APPLICATION: Final = "ahrs-service"

WORLD: Final = "/world"
NED: Final = "/world/ned"
OURS: Final = "/world/ned/ours"
THEIRS: Final = "/world/ned/theirs"
GRAVITY: Final = "/world/gravity"

ATTITUDE: Final = "/attitude"
SIGMA: Final = "/attitude_sigma"
RESIDUAL: Final = "/residual"
INNOVATION: Final = "/innovation"
BIAS: Final = "/gyro_bias"
LOAD: Final = "/gate_load"
TRUST: Final = "/state/accelerometer"
GATE: Final = "/state/gate"
SAMPLE: Final = "/state/samples"
RAW_RATE: Final = "/sensor/rate/raw"
USED_RATE: Final = "/sensor/rate/used"
RATE_CORRECTION: Final = "/sensor/rate_correction"
RAW_FORCE: Final = "/sensor/force/raw"
USED_FORCE: Final = "/sensor/force/used"
FORCE_CORRECTION: Final = "/sensor/force_correction"
TEMPERATURE: Final = "/temperature"
RATES: Final = "/rates"
DROPS: Final = "/drops"
LOG: Final = "/log"

X: Final = 0xE5484DFF
Y: Final = 0x30A46CFF
Z: Final = 0x3E7BFAFF
X_FAINT: Final = 0xF2A8AAFF
Y_FAINT: Final = 0x9AD7B6FF
Z_FAINT: Final = 0xA5C3FDFF
VIOLET: Final = 0x9B5DE5FF
OURS_PAINT: Final = (45, 110, 225)
THEIRS_PAINT: Final = (150, 155, 165)
"""x is red, y green, z blue; ours is bright, theirs faint."""
