"""What a search leaves behind: the files of a result, for people and for other programs."""
