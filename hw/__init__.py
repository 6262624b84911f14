"""The real rig: LED boards, cameras, calibration, the start-up check, and an emulated rig.

Rooms, each of which imports only from those before it:

- ``leds``: LED boards over a serial line, and the lights of the fibers;
- ``camera``: photographs, and where the pad is in them;
- ``calibration``: from photographs of single fibers to the scene's material;
- ``check``: does the untouched pad look as designed? (knows nothing of ``calibration``);
- ``emulator``: a rig without hardware, drawn or rendered with what ``calibration`` has for it;
- ``cli``: the commands.
"""
