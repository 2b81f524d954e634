"""``tbd calibrate``: a search of noise beside the model."""

import pytest

from track_before_detect.cli import main
from track_before_detect.kernels.compiled_cache import cache_folder
from track_before_detect.solvers.calibration import threshold


@pytest.fixture(autouse=True)
def few_crops(tmp_path, monkeypatch):
    # Loops stay where they were compiled.
    cache_folder()
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    for name in ('LEAST_CROPS', 'MOST_CROPS'):
        monkeypatch.setattr(threshold, name, 20)


def test_both_thresholds_are_printed_and_the_simulated_one_is_kept(capsys, tmp_path):
    options = ['--fps', '25', '--set', 'amplitude_model=either']
    assert main(['calibrate', '6', '40', '48', *options]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert 'simulated' in header and 'model' in header
    assert [row.split()[0] for row in rows] == ['fluctuating', 'constant']
    for row in rows:
        simulated, modelled = map(float, row.split()[2:4])
        assert simulated == pytest.approx(modelled, rel=0.15)
    assert len(list(tmp_path.rglob('noise-*.npy'))) == 2


def test_progress_is_as_quiet_or_verbose_as_asked_for(capsys):
    # Each of another size, for what is kept is not searched again.
    for width, loudness, said in (('24', '--quiet', False), ('28', '--verbose', True)):
        assert main(['calibrate', '3', '20', width, '--set', 'detector=cfo_dp', loudness]) == 0
        error = capsys.readouterr().err
        assert (' %' in error) == said and bool(error) == said


def test_options_beyond_the_model_have_none(capsys):
    assert main(['calibrate', '3', '20', '24', '--set', 'detector=cfo_dp']) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[3:] == ['none', 'none']


@pytest.mark.parametrize(('arguments', 'words'), [
    (['0', '20', '24'], 'frames must be'),
    (['6', '20', '24', '--fps', '0'], '--fps must be'),
    (['6', '20', '24', '--set', 'threshold=7'], 'is given'),
    (['6', '20', '24', '--set', 'calibration=clutter'], 'calibration=clutter')])
def test_what_cannot_be_calibrated_is_one_sentence(capsys, arguments, words):
    assert main(['calibrate', *arguments]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert words in line
