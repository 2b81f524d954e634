"""How close the detector is to what is possible: dim, accuracy, false-alarms."""
