"""The command ``tbd``."""

from track_before_detect.cli.commands import main

__all__ = ['main']
