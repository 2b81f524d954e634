"""Patches of many alike spots that stand in the scene: hot roofs, lamps, leaves, glitter."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from track_before_detect.simulation.backdrop import backdrop
from track_before_detect.simulation.sensor import add_streak

SHAPE = (88, 112)
SIDE_PX, N_SPOTS = 40, 26


def flickering(rng, places, n_frames):
    """Each as bright as chance has it, in every frame anew."""
    amplitudes = np.clip(1 + 0.5 * rng.standard_normal((n_frames, len(places))), 0, None)
    return np.broadcast_to(places, (n_frames, *places.shape)), amplitudes


def blinking(rng, places, n_frames):
    """Lit in two frames of five."""
    lit = rng.random((n_frames, len(places))) < 0.4
    return np.broadcast_to(places, (n_frames, *places.shape)), lit.astype(float)


def wandering(rng, places, n_frames):
    """Seen through hot air: each goes about its place by a pixel."""
    steps = rng.normal(0, 0.7, (n_frames, *places.shape))
    return places + signal.lfilter([1], [1, -0.8], steps, axis=0), np.ones(steps.shape[:2])


def glittering(rng, places, n_frames):
    """Return what lasts two frames each, and comes again elsewhere in the patch."""
    last = np.maximum.accumulate(
        np.arange(n_frames)[:, None] * (rng.random((n_frames, len(places))) < 0.5))
    drawn = rng.uniform(-SIDE_PX / 2, SIDE_PX / 2, (n_frames, *places.shape))
    brightness = rng.exponential(1, last.shape)
    spot = np.arange(len(places))
    return (places.mean(axis=0) + drawn)[last, spot], brightness[last, spot]


SPOTS: Mapping[str, Callable[..., tuple[NDArray, NDArray]]] = {
    'flickering': flickering, 'blinking': blinking, 'wandering': wandering,
    'glittering': glittering}


def straight(start, step, n_frames):
    """Return the way (T, 2) of a target."""
    return np.array(start) + np.arange(n_frames)[:, None] * np.array(step)


def recorded(rng, n_frames, targets=(), snr=4.0, spots='', spots_snr=0.0, pan_px=0.0):
    """Return counts (T, H, W) of a camera that pans over a patch of spots, and of targets.

    ``snr`` is that of the matched filter in one frame, ``spots_snr`` that of a spot in the mean;
    ``targets`` are ways in the frames.
    """
    shape = n_frames, *SHAPE
    frames = rng.standard_normal(shape)
    frames += list(backdrop(rng, shape, {3.0: 2.0}, (pan_px, 0)))
    centre = np.array(SHAPE[::-1]) / 2 + (pan_px * n_frames / 2, 0)
    places = centre + rng.uniform(-SIDE_PX / 2, SIDE_PX / 2, (N_SPOTS, 2))
    brightness = spots_snr * rng.uniform(0.8, 1.2, N_SPOTS)
    if spots:
        seen, amplitudes = SPOTS[spots](rng, places, n_frames)
        seen = seen - straight((0, 0), (pan_px, 0), n_frames)[:, None]
        for frame, at, amplitude in zip(frames, seen, brightness * amplitudes, strict=True):
            for (x, y), one in zip(at, amplitude, strict=True):
                add_streak(frame, x, y, 1.0, one, np.zeros(2))
    for way in targets:
        for frame, (x, y) in zip(frames, way, strict=True):
            add_streak(frame, x, y, 1.0, snr, np.zeros(2))
    return np.rint(3000 + 12 * frames).astype(np.uint16)
