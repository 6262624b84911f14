"""The real rig: LED boards, cameras, calibration, the start-up check, and an emulated rig."""
