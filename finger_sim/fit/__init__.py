"""A scene's tissue found from measured presses: `finger_sim fit`. Begin with `fitting.py`."""
