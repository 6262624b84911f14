"""Which serial ports there are, and opening one as an LED board."""

from __future__ import annotations

from dataclasses import dataclass

from serial.tools import list_ports

from hw.errors import PortError
from hw.leds import ProtocolName
from hw.leds.adalight_board import AdalightBoard
from hw.leds.board import Board
from hw.leds.line_board import LineBoard
from hw.leds.link import SerialLink
from hw.leds.wled_board import WledBoard
from hw.leds.wled_link import SerialWled, WebWled

WEB = ("http://", "https://")


@dataclass(frozen=True)
class PortInfo:
    """A serial port: its path, what is plugged in, and the maker's serial number (or "")."""

    port: str
    description: str
    serial_number: str


def list_serial_ports() -> list[PortInfo]:
    """Return all serial ports of USB devices, by path; others are rarely LED boards."""
    return sorted(
        (
            PortInfo(found.device, found.description or "", found.serial_number or "")
            for found in list_ports.comports()
            if found.vid is not None
        ),
        key=lambda info: info.port,
    )


def the_port(given: str | None) -> str:
    """Return ``given``, or the only port there is.

    Raises:
        PortError: there is none, or several to choose from.
    """
    if given is not None:
        return given
    found = [info.port for info in list_serial_ports()]
    if len(found) == 1:
        return found[0]
    if not found:
        raise PortError(
            "no LED board is plugged in: plug one in, name its --port, or try without one with "
            "`tactilux hw demo`",
            field="port",
        )
    raise PortError(
        f"there are {len(found)} serial ports: name one with --port, {', '.join(found)}",
        field="port",
    )


def open_board(
    port: str, protocol: ProtocolName, *, leds: int, baud: int = 115200, timeout: float = 1.0
) -> Board:
    """Return the board on ``port`` once it has said who it is.

    ``port`` is a device path, or the ``http://`` address of a WLED. An Adalight board cannot say
    how many LEDs it has; USB boards ignore ``baud``; one answer may take ``timeout`` seconds.

    Raises:
        PortError: no port, no permission, port taken, wrong device, or too few LEDs.
    """
    web = port.startswith(WEB)
    if web and protocol is not ProtocolName.WLED:
        raise PortError(
            f"--protocol {protocol} is not spoken over a network, allowed at {port}: wled; add "
            "--protocol wled, or name a serial --port",
            field="protocol",
        )
    link = WebWled(port, timeout=timeout) if web else SerialLink(port, baud=baud, timeout=timeout)
    try:
        board: Board
        if isinstance(link, WebWled):
            board = WledBoard(link)
        elif protocol is ProtocolName.LINES:
            board = LineBoard(link)
        elif protocol is ProtocolName.WLED:
            board = WledBoard(SerialWled(link))
        else:
            board = AdalightBoard(link, leds)
        if board.leds < leds:
            raise PortError(
                f"{board.name} on {port} drives {board.leds} LEDs, allowed: at least {leds}; set "
                "its number of LEDs, or map fibers with --leds",
                field="leds",
            )
    except BaseException:
        link.close()
        raise
    return board
