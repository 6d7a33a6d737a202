"""The procedures of `ahrs-service calibrate`, one file each; `command` picks one."""
