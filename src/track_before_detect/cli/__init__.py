"""The command ``tbd``."""

from track_before_detect.cli.main import main

__all__ = ['main']
