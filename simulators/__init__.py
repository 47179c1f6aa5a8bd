"""Makes a block: truth motion → sensor effects → samples → frames on a line."""
