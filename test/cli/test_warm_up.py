"""``tbd warm-up``: what to compile, by name."""

from track_before_detect.cli import main


def test_an_unknown_name_is_one_sentence_and_exit_code_2(capsys):
    assert main(['warm-up', 'everythin']) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and 'did you mean everything' in error


def test_loops_that_are_needed_are_compiled(capsys):
    assert main(['warm-up', 'cfo_dp']) == 0
    assert capsys.readouterr().out.startswith('ready in ')
