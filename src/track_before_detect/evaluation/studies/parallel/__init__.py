"""The experiments of Guo et al. 2018."""
