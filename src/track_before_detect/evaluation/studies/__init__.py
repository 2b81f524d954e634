"""The studies of ``tbd evaluate``, a folder for each."""
