"""The experiments of Fu et al. 2022."""
