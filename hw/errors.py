"""What can go wrong outside the computer; each message ends with what to do about it."""

from __future__ import annotations

from tactilux import TactiluxError


class HardwareError(TactiluxError):
    """Base of all errors of the rig."""


class PortError(HardwareError):
    """A serial port that is absent, forbidden, taken, or not an LED board."""


class LinkError(HardwareError):
    """A board that stopped answering."""


class UnpluggedError(LinkError):
    """The port itself went away: no second try without opening it again."""


class ProtocolError(HardwareError):
    """A board that answered, but not what the protocol allows."""


class PowerError(HardwareError):
    """Light that would draw more than the rig may, or that the board has no channel for."""


class CameraError(HardwareError):
    """A camera that cannot be opened, locked or read."""


class CaptureError(HardwareError):
    """A photograph that cannot be used: wrong size, over-exposed, channels swapped."""


class CalibrationError(HardwareError):
    """Photographs that no calibration should be made from, or a fit that did not converge."""
