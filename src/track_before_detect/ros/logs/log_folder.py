"""Where ROS writes its log files."""

import os
from pathlib import Path
import tempfile


def ensure_log_folder() -> str:
    """Let ROS log to a temporary folder where its own cannot be made; return a note, or nothing.

    Without a folder, as where HOME is not set or cannot be written to, no node would start.
    """
    try:
        folder = _log_folder()
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return ''
        reason = f'{folder} cannot be written to'
    except (OSError, RuntimeError) as error:
        reason = str(error)
    os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros-log-')
    return f'log files go to {os.environ["ROS_LOG_DIR"]}: {reason}'


def _log_folder() -> Path:
    """Return the folder that ROS would take."""
    named = os.environ.get('ROS_LOG_DIR')
    if named:
        return Path(named).expanduser()
    home = os.environ.get('ROS_HOME')
    if home:
        return Path(home).expanduser() / 'log'
    if not os.environ.get('HOME'):
        # The password file knows it as well, but ROS does not look there.
        raise RuntimeError('neither ROS_LOG_DIR nor HOME is set')
    return Path(os.environ['HOME']) / '.ros' / 'log'
