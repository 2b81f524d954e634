"""Find dim moving targets in sequences of frames where no single frame shows them."""

__version__ = '0.1.0'
