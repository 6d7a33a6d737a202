"""Records of DataFlash logs as their bytes."""

import struct


def fmt(number: int, name: str, letters: str, columns: str) -> bytes:
    kinds = letters.translate(str.maketrans("cCeEL", "hHiIi")).replace("N", "16s")
    length = 3 + struct.calcsize("<" + kinds)
    body = (number, length, name.encode(), letters.encode(), columns.encode())
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *body)


def imu(time_us: int, gyro: float = 0.1, temperature: float = 31.5) -> bytes:
    values = (time_us, gyro, 0.2, 0.3, 0.0, 0.0, -9.8, temperature)
    return b"\xa3\x95\x90" + struct.pack("<Q7f", *values)


IMU_FORMAT = fmt(0x90, "IMU", "Qfffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")
