"""What a page of rerun shows, in a Chromium without a window and without a graphics card."""

from contextlib import contextmanager
import io
import shutil
import time

import numpy as np
import pytest
from scipy import ndimage, signal

from track_before_detect.recordings.overlay import colour_of, contrast_limits, grey_picture

# Drawing takes minutes where other processes want the same cores.
TIMEOUT_S = 400.0
N_FRAMES, SHAPE, RATE_HZ = 40, (48, 64), 25.0
# Side of the box around a target, and what a trajectory may be off, in pixels of the frames.
BOX_PX, OFF_PX = 8.0, 1.0
# What lines that are drawn may be off, in pixels of the page.
LEAST_OFF = 2.0
# Width and height of the number below a box, at most, in pixels of the page.
LABEL = 90, 35
# Of two colours that are the same, at most, in each channel.
ALIKE = 40


def make_clip():
    """Return a scene with a dark roof, a bright lamp and a target that crosses it, and where."""
    frames = np.random.default_rng(5).normal(100, 2, (N_FRAMES, *SHAPE)).astype(np.float32)
    frames[:, 3:8, 4:11] -= 20
    frames[:, 3:7, 55:59] += 20
    rows, columns = np.mgrid[:SHAPE[0], :SHAPE[1]]
    k = np.arange(N_FRAMES)
    positions = np.column_stack([8 + 1.2 * k, 38 - 0.5 * k])
    for frame, (x, y) in zip(frames, positions, strict=True):
        frame += 12 * np.exp(-0.5 * ((columns - x)**2 + (rows - y)**2))
    return frames, positions


@contextmanager
def opened_page(address):
    """Open a page in a browser, or skip the test."""
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is missing')
    browsers = filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome')))
    with playwright.sync_playwright() as running:
        try:
            browser = running.chromium.launch(executable_path=next(browsers, None), args=[
                '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
                '--ignore-gpu-blocklist'])
        except playwright.Error:
            pytest.skip('Chromium is missing')
        page = browser.new_page(viewport={'width': 640, 'height': 480})
        page.goto(address, timeout=1000 * TIMEOUT_S)
        yield page
        browser.close()


def wait_until_shown(page, frame, positions, identity, folder):
    """Wait until a trajectory that has come along these positions is on a frame, there alone."""
    from PIL import Image

    end_s, file = time.monotonic() + TIMEOUT_S, folder / 'page.png'
    wrong = 'no page'
    while wrong and time.monotonic() < end_s:
        picture = page.screenshot(timeout=1000 * TIMEOUT_S)
        file.write_bytes(picture)
        wrong = what_is_wrong(np.array(Image.open(io.BytesIO(picture)).convert('RGB'), float),
                              frame, positions, colour_of(identity))
    assert not wrong, f'{wrong}, see {file}'


def what_is_wrong(picture, frame, positions, colour):
    """Return what is not where it should be in the picture (H, W, 3) of a page."""
    coloured = (np.abs(picture - colour) < ALIKE).all(axis=-1)
    if not coloured.any():
        return 'nothing is of the colour of the trajectory'
    (left, top), scale = frame_in(picture, frame)
    height, width = np.rint(np.multiply(frame.shape, scale)).astype(int)
    coloured = coloured[top:top + height, left:left + width]
    # The middle of the first pixel is at half a pixel.
    places = scale * (np.asarray(positions) + 0.5)
    half, off = scale * BOX_PX / 2, max(scale * OFF_PX, LEAST_OFF)
    x, y = places[-1]
    along = np.linspace(-half, half, 20)
    # The number is at the lower side.
    sides = np.concatenate([np.column_stack([x + along, np.full(20, y - half)]), *(
        np.column_stack([np.full(20, x + side), y + along]) for side in (-half, half))])
    far = ndimage.distance_transform_edt(~coloured)
    on_sides = np.array([far[round(row), round(column)] < off for column, row in sides])
    if on_sides.mean() < 0.9:
        return f'{on_sides.mean():.0%} of the box around {positions[-1]}'
    allowed = np.zeros(coloured.shape, bool)
    for column, row in np.concatenate([places, sides]):
        allowed[round(row), round(column)] = True
    # From one frame to the next a target moves by more than a pixel.
    allowed = ndimage.distance_transform_edt(~allowed) < 2 * off
    below, left = round(y + half - off), max(round(x) - LABEL[0] // 2, 0)
    allowed[below:below + LABEL[1], left:left + LABEL[0]] = True
    return f'{(coloured & ~allowed).sum()} pixels elsewhere' * bool((coloured & ~allowed).any())


def frame_in(picture, frame):
    """Return the first column and row of a frame (H, W) in a picture, and its scale there."""
    from PIL import Image

    # It is the first of three in a row at least.
    grey = picture[:, :picture.shape[1] // 3 + 2].mean(axis=-1)
    squares = np.pad((grey**2).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    shown = Image.fromarray(grey_picture(frame, *contrast_limits(frame)))
    best = np.inf, (0, 0), 1.0
    for width in range(grey.shape[1] // 2, grey.shape[1]):
        size = width, round(width * frame.shape[0] / frame.shape[1])
        if size[1] > grey.shape[0]:
            break
        scaled = np.asarray(shown.resize(size), float)
        x, y = size
        far = (squares[y:, x:] - squares[:-y, x:] - squares[y:, :-x] + squares[:-y, :-x]
               + (scaled**2).sum() - 2 * signal.oaconvolve(grey, scaled[::-1, ::-1], 'valid'))
        place = np.unravel_index(far.argmin(), far.shape)
        best = min(best, (far[place] / scaled.size, place[::-1], width / frame.shape[1]))
    return best[1:]
