"""False alarms that were asked for and that came."""
