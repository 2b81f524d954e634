"""Words for what looks wrong, and which option to turn."""

import numpy as np

from track_before_detect.inspection.observation import Observation
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import searched_speed
from track_before_detect.types import DetectionResult

# Agreement of neighbouring pixels, or of a pixel with itself a frame later, that is not white.
COLOURED = 0.15
# Factor by which the spread of what is searched may differ from one.
MOST_SPREAD = 1.5
# Share of frames or pixels that is worth a sentence.
MANY = 0.05
# Trajectories per batch beyond which they are hardly all targets.
MOST_PER_BATCH = 3.0
# Motion of the scene in pixels per frame that a search without registration should know of.
MOVING_PX = 0.2
# Share of the largest speed at which a target may be faster still.
NEAR_LIMIT = 0.95


def findings(observed: Observation, result: DetectionResult, n_frames: int) -> list[str]:
    """Return a sentence for each thing that looks wrong.

    Parameters
    ----------
    observed : Observation
        Of a whole search, with the motion of the scene.
    result : DetectionResult
        What was found.
    n_frames : int
        Frames of the recording.
    """
    options = observed.options
    return [*_frames(observed, options, n_frames), *_scale(observed, options),
            *_whiteness(observed, options), *_motion(observed, options),
            *_found(observed, result, options)]


def _frames(observed: Observation, options: DetectorOptions, n_frames: int) -> list[str]:
    missed = n_frames - observed.frames_searched()
    words = []
    if missed > MANY * n_frames:
        words.append(
            f'{missed} of {n_frames} frames were not searched: they repeat the one before, or '
            'their stamps do not increase. Record without a frame rate conversion; '
            'batch_length counts the other frames.')
    no_data = float(np.mean([fact.no_data for fact in observed.all_facts()]))
    if no_data > MANY:
        words.append(
            f'{100 * no_data:.0f} % of the pixels searched hold no data: they are masked, not '
            'finite, or the moving camera leaves them'
            + ('; a shorter batch_length or search_plane=image leaves more.'
               if options.registration != 'none' and options.search_plane == 'scene' else '.'))
    return words


def _scale(observed: Observation, options: DetectorOptions) -> list[str]:
    words = []
    middle = float(np.median([fact.middle for fact in observed.all_facts()]))
    spread = float(np.median([fact.spread for fact in observed.all_facts()]))
    if abs(middle) > 1:
        words.append(
            f'What is searched has a median of {middle:.3g} times its noise instead of 0: a '
            f'background is still in it (background={options.background}). Try '
            'background=temporal_median, or spatial_median for targets that hover.')
    # Noise that is not white, and the surroundings of a pixel, make the scale larger on purpose.
    if spread > MOST_SPREAD or (options.noise == 'none' and spread < 1 / MOST_SPREAD):
        words.append(
            f'What is searched has a spread of {spread:.3g} instead of 1 '
            f'(noise={options.noise}), so statistics and thresholds mean little. Try '
            f'noise={"robust" if options.noise == "none" else "local"}.')
    return words


def _whiteness(observed: Observation, options: DetectorOptions) -> list[str]:
    words = []
    # Of several backgrounds the one that leaves least.
    space, time = (min(lags[1] if len(lags) > 1 else 0.0 for lags in both) for both in zip(
        *map(observed.whiteness, observed.facts), strict=True))
    if space > COLOURED:
        words.append(
            f'The residual is not white in space: neighbouring pixels agree by {space:.2f}. A '
            'video codec, a blurred sensor or a left-over scene does that. '
            + ('Try noise=robust or noise=local, which measure it. ' if options.noise == 'none'
               else 'The scale already takes it into account; ')
            + 'a wider psf_sigma_px, if targets are wider than '
            f'{options.psf_sigma_px:g} px, suffers less from it.')
    if time > COLOURED:
        kept = options.background in ('none', 'spatial_median')
        words.append(
            f'The residual is not white in time: pixels agree with the frame before by {time:.2f}'
            ', so what is left of the scene looks like slow targets. '
            + ('Try background=temporal_median, or either.' if kept else
               'Try registration=translation if the camera moves.'
               if options.registration == 'none' else
               'Try registration=affine if it turns or zooms.'
               if options.registration == 'translation' else '')
            + ('' if options.calibration == 'clutter'
               else ' calibration=clutter takes its threshold from such a residual.'))
    return words


def _motion(observed: Observation, options: DetectorOptions) -> list[str]:
    _, motion, sure = observed.motion()
    if not len(sure):
        return []
    doubtful = float(np.mean(~sure))
    if options.registration != 'none' and doubtful > MANY:
        return [f'Registration is not credible in {100 * doubtful:.0f} % of the frames: the '
                'scene shows too little, or changes too much. Try registration=none if the camera '
                'stands still' + (', registration=translation if it only pans.' if
                                  options.registration != 'translation' else '.')]
    if options.registration == 'none' and doubtful < 0.5:
        speed = float(np.median(np.hypot(*motion[sure].T)))
        if speed > MOVING_PX:
            return [f'The scene moves by {speed:.2f} px per frame and registration=none ignores '
                    'it. Try registration=translation, or affine if the camera turns or zooms.']
    return []


def _found(observed: Observation, result: DetectionResult,
           options: DetectorOptions) -> list[str]:
    at, strongest = observed.strongest()
    n_found = len(result.trajectories)
    words = []
    if result.status != 'converged':
        words.append(f'A batch was left before its end was reached ({result.status}): what was '
                     'found is not all, or hardly targets.')
    known = np.isfinite(strongest)
    above = [one for one in result.rejected if one.statistic > result.threshold]
    if not n_found and above:
        strong = max(above, key=lambda one: one.statistic)
        words.append(
            f'Nothing is left of {len(above)} candidate{"s" * (len(above) > 1)} above the '
            f'threshold: the strongest, {strong.statistic / result.threshold:.2f} of it, is '
            f'rejected: {strong.reason}. The table of candidates has all.')
    elif not n_found and known.any():
        best = int(np.nanargmax(strongest))
        words.append(
            f'Nothing passes the threshold: the best path, around frame {at[best]:.0f}, reaches '
            f'{strongest[best]:.2f} of it. A larger false_alarm_rate lowers the threshold, a '
            'longer batch_length adds frames up; max_speed_px_s and psf_sigma_px may not fit the '
            'target.')
    if n_found > MOST_PER_BATCH * result.n_batches:
        words.append(
            f'{n_found} trajectories in {result.n_batches} '
            f'batch{"es" if result.n_batches > 1 else ""} are hardly all targets. Try '
            'noise=local and calibration=clutter, which compare paths with their surroundings.')
    batch = observed.views[0].batch
    limit = searched_speed(options, batch.stamps, batch.frames.shape[1:])
    speeds = [np.nanmedian(np.hypot(*one.velocity.T)) for one in result.trajectories
              if np.isfinite(one.velocity).any()]
    if options.search_plane == 'image' or options.registration == 'none':
        fast = sum(speed > NEAR_LIMIT * limit for speed in speeds)
        if fast:
            words.append(f'{fast} of {n_found} trajectories are at the largest speed searched, '
                         f'{limit:.3g} px/s: a larger max_speed_px_s may follow them better.')
    return words
