"""How much memory a search may take."""

from track_before_detect.solvers.search.memory import memory_for_search


def test_memory_is_what_was_told_or_a_share_of_what_is_free():
    assert memory_for_search(0.25) == 0.25e9
    # A machine whose memory nobody knows is taken for a small one.
    assert 2**30 <= memory_for_search(None) < 2**50
