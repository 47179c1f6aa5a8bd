"""Parts of the soak: the plant under test, what befalls it, what must not be lost, and whether memory grows."""
