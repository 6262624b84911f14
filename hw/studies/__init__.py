"""How well faults are found and calibration recovers rigs, over many random rigs."""
