"""Whether tests take the samples and instants that need hours: ``make validation-long`` does."""

from __future__ import annotations

import os

LONG = os.environ.get("TACTILUX_LONG", "") not in ("", "0")
