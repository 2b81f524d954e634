"""Where the executables begin and end."""
