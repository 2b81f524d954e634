"""``tbd config``, ``--quiet``, ``--verbose`` and completion."""

import subprocess

import pytest

from track_before_detect.cli import main
from track_before_detect.options import describe, DetectorOptions

yaml = pytest.importorskip('yaml', reason='the extra [cli] is missing')


@pytest.fixture
def printed(capsys):
    assert main(['config']) == 0
    return capsys.readouterr().out


def test_each_option_is_in_the_file_once_with_its_default_and_meaning(printed):
    opened = '\n'.join(line.removeprefix('#') if line[1:2].isalpha() else line
                       for line in printed.splitlines())
    values = yaml.safe_load(opened)
    assert values.pop('preset') == 'auto'
    assert set(values) == {option['name'] for option in describe()}
    assert DetectorOptions.from_mapping(values) == DetectorOptions()
    words = ' '.join(printed.replace('#', ' ').split())
    for option in describe():
        assert ' '.join(option['description'].replace('#', ' ').split()) in words
        assert printed.count(f'\n#{option["name"]}: ') == 1


def test_the_file_as_it_is_changes_nothing_and_an_opened_option_counts(
        printed, recording_file, stand_in, tmp_path):
    path = tmp_path / 'options.yaml'
    arguments = ['detect', str(recording_file), '--no-overlay', '--output', str(tmp_path / 'out')]
    chosen = []
    for text in ('', printed, printed.replace('#hop: null', 'hop: 3').replace(
            '#batch_length: null', 'batch_length: 5')):
        path.write_text(text)
        assert main([*arguments, '--config', str(path)]) == 0
        chosen.append(stand_in.options)
    assert chosen[0] == chosen[1]
    assert chosen[2] == chosen[0].replace(batch_length=5, hop=3)


def test_quiet_says_the_result_alone_and_verbose_how_far_it_is(
        recording_file, stand_in, tmp_path, capsys):
    arguments = ['detect', str(recording_file), '--no-overlay', '--output', str(tmp_path / 'out')]
    said = {}
    for how in ('--quiet', '--verbose'):
        assert main([*arguments, how]) == 0
        captured = capsys.readouterr()
        assert '12.35' in captured.out
        said[how] = captured.err
    assert said['--quiet'] == ''
    assert 'tbd: searching: 50 %' in said['--verbose'].splitlines()


def test_only_verbose_says_where_an_error_comes_from(tmp_path, capsys, caplog):
    for how, shown in (([], False), (['-v'], True)):
        assert main(['detect', str(tmp_path / 'missing.npz'), *how]) == 2
        assert ('Traceback' in caplog.text) == shown
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith('tbd: error: ')


def test_a_shell_completes_commands_and_detectors(capsys):
    pytest.importorskip('shtab', reason='the extra [completion] is missing')
    with pytest.raises(SystemExit) as stop:
        main(['--print-completion', 'bash'])
    assert stop.value.code == 0
    script = capsys.readouterr().out
    for words, expected in ((['tbd', 'det'], 'detect'),
                            (['tbd', 'detect', '--detector', 'gree'], 'greedy'),
                            (['tbd', 'detect', '--verb'], '--verbose')):
        program = (f'{script}\nCOMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}; '
                   '_shtab_tbd; echo "${COMPREPLY[@]}"')
        done = subprocess.run(['bash', '-c', program], capture_output=True, text=True,
                              timeout=30)
        assert done.stdout.split() == [expected], done.stderr


def test_an_unknown_shell_is_one_sentence(capsys):
    with pytest.raises(SystemExit) as stop:
        main(['--print-completion', 'fish'])
    assert stop.value.code == 2
    assert "'fish'" in capsys.readouterr().err
