"""What a page of rerun shows, in a Chromium without a window and without a graphics card."""

from contextlib import contextmanager
import io
import shutil
import time

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.recordings.overlay import colour_of

# Drawing takes minutes where other processes want the same cores.
TIMEOUT_S = 400.0
N_FRAMES, SHAPE, RATE_HZ = 40, (48, 64), 25.0
# Side of the box around a target, and what a trajectory may be off, in pixels of the frames.
BOX_PX, OFF_PX = 8.0, 1.0
# Width and height of the number below a box, at most, in pixels of the page.
LABEL = 90, 35
# Of two colours that are the same, at most, in each channel.
ALIKE = 40


def make_clip():
    """Return a scene with a dark roof, a bright lamp and a target that crosses it, and where.

    Nearly all of it is of a middle grey, so that it is found on a page.
    """
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


def wait_until_shown(page, positions, identity, folder):
    """Wait until the page shows a trajectory that has come along these positions, there alone."""
    from PIL import Image

    end_s, file = time.monotonic() + TIMEOUT_S, folder / 'page.png'
    wrong = 'no page'
    while wrong and time.monotonic() < end_s:
        picture = page.screenshot(timeout=1000 * TIMEOUT_S)
        file.write_bytes(picture)
        wrong = what_is_wrong(np.array(Image.open(io.BytesIO(picture)).convert('RGB'), float),
                              positions, colour_of(identity))
    assert not wrong, f'{wrong}, see {file}'


def what_is_wrong(picture, positions, colour):
    """Return what is not where it should be in the picture (H, W, 3) of a page."""
    rows, columns = frame_in(picture)
    scale = (columns.stop - columns.start) / SHAPE[1]
    if not np.isclose(scale, (rows.stop - rows.start) / SHAPE[0], rtol=0.03):
        return f'no frame, but something grey in {rows}, {columns}'
    frame = picture[rows, columns]
    coloured = (np.abs(frame - colour) < ALIKE).all(axis=-1)
    # The middle of the first pixel is at half a pixel.
    places = scale * (np.asarray(positions) + 0.5)
    half, off = scale * BOX_PX / 2, scale * OFF_PX
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


def frame_in(picture):
    """Return the rows and columns of the largest grey area of a picture."""
    grey = (np.ptp(picture, axis=-1) < 12) & (abs(picture.mean(axis=-1) - 128) < 60)
    areas, n_areas = ndimage.label(grey)
    if not n_areas:
        return slice(0, 1), slice(0, SHAPE[1])
    largest = ndimage.sum_labels(grey, areas, np.arange(1, n_areas + 1)).argmax()
    return ndimage.find_objects(areas)[largest]
