"""A scene that can be stepped: the simulator, and bags replayed through it."""
