"""How many paths of noise pass a level, for many options: the table of the model of noise."""
