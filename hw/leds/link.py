"""A serial line: opened for one program alone, read with deadlines."""

from __future__ import annotations

import errno
import os
import termios
import time
from collections.abc import Callable

import serial

from hw.errors import LinkError, PortError, ProtocolError, UnpluggedError

LONGEST_LINE = 32768
"""Bytes after which a line without an end is called garbage; WLED answers in long ones."""

GONE = (serial.SerialException, OSError, termios.error, TypeError)
"""What a pulled cable looks like; pyserial meets a closed descriptor as TypeError."""


class SerialLink:
    """One open serial port.

    Arguments:
        port: device path, for example ``/dev/ttyACM0``.
        baud: bits per second.
        timeout: seconds that one answer may take.
    """

    def __init__(self, port: str, *, baud: int = 115200, timeout: float = 1.0) -> None:
        """Open the port.

        Raises:
            PortError: no such port, no permission, or taken by another program.
        """
        self.port, self.timeout = port, timeout
        self._rest = b""
        try:
            self._serial = serial.Serial(
                port, baud, timeout=timeout, write_timeout=timeout, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise _port_error(port, error) from None

    def close(self) -> None:
        """Close the port; closing twice is no mistake."""
        self._serial.close()

    def write(self, content: bytes) -> None:
        """Send all of ``content``.

        Raises:
            LinkError: the board takes nothing, or the cable was pulled (`UnpluggedError`).
        """
        try:
            self._serial.write(content)
            self._serial.flush()
        except serial.SerialTimeoutException:
            raise self._lost("takes no more data") from None
        except GONE:
            raise self._gone() from None

    def read_line(self, deadline: float) -> bytes:
        """Return the next line without its end.

        It is waited for until ``deadline``, a `time.monotonic` instant.

        Raises:
            LinkError: none came in time, or the cable was pulled (`UnpluggedError`).
            ProtocolError: too many bytes without a line end.
        """
        while True:
            # First of all: a board that never falls silent must not hold us.
            remaining = deadline - time.monotonic()
            if remaining <= 0:
                raise self._lost("did not answer in time")
            if b"\n" in self._rest:
                line, _, self._rest = self._rest.partition(b"\n")
                return line.rstrip(b"\r")
            if len(self._rest) > LONGEST_LINE:
                self._rest = b""
                raise ProtocolError(
                    f"{self.port} sends bytes without line ends: choose the board's own --protocol "
                    "and --baud",
                    field="port",
                )
            try:
                self._serial.timeout = min(remaining, 0.05)
                # One byte at least, then all that has come: never waits for more than there is.
                self._rest += self._serial.read(max(1, self._serial.in_waiting))
            except GONE:
                raise self._gone() from None

    def forget(self) -> None:
        """Drop what has come but was not read: late answers, greetings, noise."""
        self._rest = b""
        try:
            self._serial.reset_input_buffer()
        except GONE:
            raise self._gone() from None

    def _gone(self) -> UnpluggedError:
        return UnpluggedError(
            f"the LED board on {self.port} is gone: check cable and power, then try again",
            field="port",
        )

    def _lost(self, what: str) -> LinkError:
        return LinkError(
            f"the LED board on {self.port} {what}: check cable and power, then try again",
            field="port",
        )


def _port_error(port: str, error: Exception) -> PortError:
    number = getattr(error, "errno", None)
    cause = error.__context__
    if number is None and isinstance(cause, termios.error):  # pyserial tells it in brackets
        number = cause.args[0]
    said: dict[int, Callable[[], str]] = {
        errno.ENOENT: lambda: (
            f"there is no port {port}: plug the board in, see `tactilux hw ports`"
        ),
        errno.EACCES: lambda: (
            f"you may not use {port}: add yourself to its group with "
            f"`sudo usermod -a -G {_group(port)} $USER` and log in again"
        ),
        errno.EAGAIN: lambda: f"{port} is in use by another program: end that program first",
        errno.EBUSY: lambda: f"{port} is in use by another program: end that program first",
    }
    if number in said:
        message = said[number]()
    else:
        reason = os.strerror(number) if number else str(error).strip() or type(error).__name__
        message = (
            f"{port} is not a serial port that can be opened ({reason}): see `tactilux hw ports`"
        )
    return PortError(message, field="port")


def _group(port: str) -> str:
    import grp

    try:
        return grp.getgrgid(os.stat(port).st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"
