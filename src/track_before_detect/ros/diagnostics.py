"""The diagnostics message of the detector, and the warnings it repeats."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import math
import threading
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from track_before_detect.options import describe, DetectorOptions
from track_before_detect.ros.frame_queue import Counters
from track_before_detect.ros.intake.sensor_stream import SensorCount
from track_before_detect.ros.search_results import Status

WARNING_PERIOD_S = 5.0


@dataclass
class Warnings:
    """What went wrong last, and when each kind of it was logged; any thread may add to it.

    Attributes
    ----------
    log : callable
        Takes a sentence.
    last : str
        The newest warning, empty before the first.
    """

    log: Callable[[str], Any]
    last: str = ''
    _last_s: float = -math.inf
    _logged_s: dict[str, float] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, kind: str, text: str) -> None:
        """Keep a warning, and log it unless its kind was logged a few seconds ago."""
        now_s = time.monotonic()
        with self._lock:
            self.last, self._last_s = text, now_s
            if now_s - self._logged_s.get(kind, -math.inf) < WARNING_PERIOD_S:
                return
            self._logged_s[kind] = now_s
        self.log(text)

    def are_recent(self) -> bool:
        """Return whether the newest warning is a few seconds old at most."""
        return time.monotonic() - self._last_s < WARNING_PERIOD_S


@dataclass
class Reception:
    """Who sends, and what the middleware did not deliver."""

    n_senders: int = 0
    n_lost: int = 0
    n_incompatible: int = 0


def option_words(options: DetectorOptions) -> str:
    """Return the options that are not the default, as text."""
    values = {option['name']: (getattr(options, option['name']), option['default'])
              for option in describe()}
    return ', '.join(f'{name}={value}' for name, (value, default) in values.items()
                     if value != default)


def diagnostics_message(name: str, stamp: Time, status: Status, counters: Counters,
                        n_waiting: int, reception: Reception, warnings: Warnings,
                        sensors: Mapping[str, SensorCount] | None = None, region: str = '',
                        ) -> DiagnosticArray:
    """Return the state of the search with all counters.

    Parameters
    ----------
    name : str
        Of the node, with its namespace.
    stamp : Time
        Of the message.
    status : Status
        Where the search is; ``failed`` is an error.
    counters : Counters
        Of frames and batches.
    n_waiting : int
        Frames in the queue.
    reception : Reception
        Of the subscriptions.
    warnings : Warnings
        A recent one is the message as a whole.
    sensors : mapping, optional
        Of several sensors by name.
    region : str, optional
        The part of the frames that is searched, in words.
    """
    message = f'{status.state}: {status.detail}' if status.detail else status.state
    values: dict[str, Any] = {
        'state': status.state,
        'detail': status.detail,
        'preparing_beside': status.beside,
        'preset': status.preset,
        'options': option_words(status.options),
        'reasons': '; '.join(status.reasons),
        'frame_size': '' if status.shape is None else f'{status.shape[0]} x {status.shape[1]}',
        'region': region,
        'searching': str(status.searching).lower(),
        'threshold': f'{status.threshold:.4f}',
        'processing_time_ms': f'{1e3 * status.processing_s:.1f}',
        'longest_processing_time_ms': f'{1e3 * status.longest_processing_s:.1f}',
        'latency_ms': f'{1e3 * status.latency_s:.1f}',
        'frames_received': counters.received,
        'frames_used': counters.used,
        'frames_waiting': n_waiting,
        'frames_dropped': counters.dropped,
        'frames_refused': counters.refused,
        'publishers': reception.n_senders,
        'messages_lost': reception.n_lost,
        'incompatible_publishers': reception.n_incompatible,
        'window_restarts': counters.restarts,
        'batches': counters.batches,
        'trajectories': counters.trajectories,
        'failures': counters.failures,
        'last_warning': warnings.last,
    }
    for sensor, count in (sensors or {}).items():
        values |= {
            f'{sensor}.frames_received': count.received, f'{sensor}.frames_late': count.late,
            f'{sensor}.silent_s': f'{count.silent_s(time.monotonic()):.1f}'}
    return status_message(name, stamp, message, values, warnings,
                          message if status.state == 'failed' else '')


def status_message(name: str, stamp: Time, message: str, values: Mapping[str, Any],
                   warnings: Warnings | None = None, trouble: str = '') -> DiagnosticArray:
    """Return diagnostics of one node, with values as text.

    In place of ``message`` they say what trouble there is, or a recent warning, at that level.
    """
    level = DiagnosticStatus.OK
    if trouble:
        level, message = DiagnosticStatus.ERROR, trouble
    elif warnings is not None and warnings.are_recent():
        level, message = DiagnosticStatus.WARN, warnings.last
    return DiagnosticArray(header=Header(stamp=stamp), status=[DiagnosticStatus(
        level=level, name=name, message=message, hardware_id='',
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])])
