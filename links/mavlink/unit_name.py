"""Which autopilot it is, by the number of its board."""


def unit_name(uid: int, uid2: bytes) -> str:
    """Return the unit's number as hex digits: uid2 without the zeros that fill it up, else uid.

    Empty where the autopilot reports neither.
    """
    reported = uid2.rstrip(b"\0")
    if reported:
        return reported.hex()
    return f"{uid:016x}" if uid else ""
