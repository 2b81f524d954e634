"""Errors this package raises on purpose."""


class TbdError(Exception):
    """Root of every error raised on purpose by this package."""


class ParameterError(TbdError, ValueError):
    """An option or argument has a value that cannot be used."""


class DataError(TbdError, ValueError):
    """Input data (an array, a file, a message) cannot be used."""


class MissingExtraError(TbdError, ImportError):
    """An optional dependency is needed for what was asked and is not installed."""
