"""What the report of the suite ``compare`` says of its numbers."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.metrics.roc import Roc

# Share of targets by which ours may be behind, and for the rounding of differences.
MARGIN = 0.02 + 1e-9
# Shares of noise batches at which a curve is read off.
ROC_RATES = (0.01, 0.05, 0.2)


class Standing(NamedTuple):
    """How the convex detector stands to the best other method in a scene.

    Attributes
    ----------
    scene : str
        The scene.
    snr : float
        Amplitude over noise.
    ours, rival : str
        Names of the two.
    gain, low, high : float
        Share of targets that ours finds more, with its 95 % interval.
    found : mapping
        Share of targets found, by the name of every method.
    """

    scene: str
    snr: float
    ours: str
    rival: str
    gain: float
    low: float
    high: float
    found: Mapping[str, float]

    @property
    def verdict(self) -> str:
        """Say in a few words who is ahead."""
        if self.gain >= 0:
            return f'{self.ours} is best'
        if self.gain >= -MARGIN:
            return f'{self.ours} is within 2 points'
        return f'{self.ours} is behind{"" if self.high < 0 else ", within chance"}'


def reasons(standings: Sequence[Standing]) -> str:
    """Return the part of the report on where ours is behind, and what would change it."""
    behind = [one for one in standings if one.gain < -MARGIN]
    title = '## Where the convex detector is behind by more than 2 points'
    if not behind:
        return f'{title}\n\nNowhere.'
    variants = [name for name in behind[0].found if name.startswith('convex')]
    lines = [title, '', *markdown_table(
        ('scene', 'SNR', 'ours', 'best other', 'ours minus other', 'from', 'to', *variants),
        [(one.scene, f'{one.snr:g}', one.ours, f'{one.rival}: {100 * one.found[one.rival]:.1f} %',
          *(f'{100 * value:.1f}' for value in (one.gain, one.low, one.high)),
          *(f'{100 * one.found[name]:.1f} %' for name in variants)) for one in behind]), '']
    for one in behind:
        lines.append(f'- {one.scene}, SNR {one.snr:g}: {_reason(one)}')
    return '\n'.join(lines)


def _reason(one: Standing) -> str:
    """Say what the other method is told or spared, and what the variants of ours show of it."""
    if one.ours == 'convex-partial':
        whole, free = (100 * one.found[name] for name in ('convex', one.ours))
        return (
            f'free to enter and leave, paths compete with more noise than those of {one.rival}. '
            f'Told that targets are there in all frames the convex detector finds {whole:.1f} %, '
            f'told that they may enter and leave {free:.1f} %. A lower cost of entering and '
            'leaving would find more of these, and fewer of those that stay.')
    if one.rival == 'velocity_filter':
        straight = one.found['convex-straight']
        left = straight - one.found[one.rival]
        text = (
            f'{one.rival} adds up along straight lines alone, so fewer motions of noise compete '
            'with the target; ours allows for turns. Told the same, it finds '
            f'{100 * straight:.1f} % ({100 * left:+.1f} points to {one.rival}), ')
        return text + (
            'so motion_model=constant_velocity, or a lower max_acceleration_px_s2, changes it.'
            if left >= -MARGIN else
            'so the freedom to turn is not all of it.')
    return (
        f'nothing that {one.rival} is told explains it. The convex detector finds '
        + ', '.join(f'{100 * value:.1f} % as "{name}"' for name, value in one.found.items()
                    if name.startswith('convex') and name != one.ours) + '.')


def roc_table(curves: Mapping[str, Roc], title: str) -> str:
    """Return the part of the report on the share of targets found at other thresholds."""
    rows = []
    for name, curve in curves.items():
        cells = []
        for rate in ROC_RATES:
            within = np.flatnonzero(curve.alarmed_batches[:, 0] <= rate)
            if not len(within):
                cells.append('-')
                continue
            share, low, high = 100 * curve.detection_probability[within[-1]]
            cells.append(f'{share:.1f} ({low:.1f} to {high:.1f})')
        rows.append((name, *cells))
    return '\n'.join([
        f'## Targets found in per cent, {title}', '',
        *markdown_table(('method', *(f'{100 * rate:g} % of noise batches' for rate in ROC_RATES)),
                        rows), '',
        'Each threshold is set where at most that share of the noise batches of this study has a '
        'trajectory, so no calibration has a part in it.'])
