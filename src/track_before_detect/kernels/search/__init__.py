"""Compiled search of the best path over a state graph (Viterbi)."""
