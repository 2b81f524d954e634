"""Dynamic programming and its ring forms (Fu et al. 2022)."""
