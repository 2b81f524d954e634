"""``tbd warm-up``: what to compile, by name, and that a search then compiles nothing more."""

import json
import subprocess
import sys

import numpy as np
from scipy import ndimage

from track_before_detect.cli import main

N_FRAMES, HEIGHT, WIDTH = 20, 64, 80
# Runs commands one after the other; prints their exit codes, and the loops, each with the types
# of its arguments, that each of them loaded or compiled first.
PROGRAM = """import contextlib, io, json, sys
from numba.core.dispatcher import Dispatcher
from track_before_detect.cli import main
seen, codes, news = set(), [], []
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()):
        codes.append(main(words))
    now = {f'{loop.__module__}:{loop.__name__}{types}'
           for name, module in list(sys.modules.items()) if name.startswith('track_before_detect.')
           for loop in vars(module).values() if isinstance(loop, Dispatcher)
           for types in loop.overloads}
    news.append(sorted(now - seen))
    seen |= now
print(json.dumps([codes, news]))
"""


def test_an_unknown_name_is_one_sentence_and_exit_code_2(capsys):
    assert main(['warm-up', 'everythin']) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and 'did you mean everything' in error


def test_loops_that_are_needed_are_compiled(capsys):
    assert main(['warm-up', 'cfo_dp']) == 0
    assert capsys.readouterr().out.startswith('ready in ')


def with_target(frames, amplitude):
    """Add a target that moves by 0.6 and 0.3 px per frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for t, frame in enumerate(frames):
        frame += amplitude * np.exp(-((x - 30 - 0.6 * t)**2 + (y - 20 - 0.3 * t)**2) / 4.5)
    return frames


def scene(rng, shake_px, turn_deg):
    """Return what a camera sees that shakes along its rows and turns, shape (T, H, W)."""
    hills = 300 * ndimage.gaussian_filter(rng.normal(size=(120, 120)), 3) + 100
    frames = [ndimage.rotate(hills, turn_deg * t, reshape=False)[
        30:30 + HEIGHT, 30 + round(shake_px * np.sin(t)):][:, :WIDTH] for t in range(N_FRAMES)]
    return with_target(np.array(frames) + rng.normal(size=(N_FRAMES, HEIGHT, WIDTH)), 12.0)


def test_nothing_is_left_to_compile_for_a_search_without_options(tmp_path):
    rng = np.random.default_rng(1)
    recordings = {'noise': with_target(rng.normal(size=(N_FRAMES, HEIGHT, WIDTH)), 4.0),
                  'still': scene(rng, 0, 0), 'shaking and turning': scene(rng, 3, 0.3)}
    commands = [['warm-up', '--quiet']]
    for name, frames in recordings.items():
        path = tmp_path / f'{name}.npz'
        np.savez(path, frames=frames, stamps=np.arange(N_FRAMES) / 10)
        commands.append(['detect', str(path), '--output', str(tmp_path / name), '--quiet'])
    child = subprocess.run([sys.executable, '-c', PROGRAM, json.dumps(commands)], text=True,
                           stdout=subprocess.PIPE, check=True)
    codes, news = json.loads(child.stdout)
    assert codes == [0] * len(commands)
    assert news[0]
    assert dict(zip(recordings, news[1:], strict=True)) == {name: [] for name in recordings}
