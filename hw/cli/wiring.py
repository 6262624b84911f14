"""How the lights are connected; pyserial is imported when they are opened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hw.leds.fiber_lights import FiberLights


@dataclass(frozen=True)
class Wiring:
    """How the lights are connected, as the options of the command line say."""

    port: str | None
    protocol: str
    baud: int
    leds: str | None
    order: str
    limit_ma: float
    scale: float

    def lights(self, fibers: int) -> FiberLights:
        """Open the board for ``fibers`` fibers."""
        from hw.leds.channels import ChannelMap, PowerLimits
        from hw.leds.fiber_lights import FiberLights
        from hw.leds.ports import ProtocolName, open_board, the_port

        channels = ChannelMap.parse(self.leds, fibers, self.order)
        connect = partial(
            open_board,
            the_port(self.port),
            ProtocolName(self.protocol),
            leds=channels.needed,
            baud=self.baud,
        )
        return FiberLights(connect, channels, PowerLimits(total_milliamperes=self.limit_ma))
