"""The solvers of a step by number, as compiled code knows them, and their levels of accuracy."""

PGS, NEWTON = 0, 1
METHODS = {"pgs": PGS, "newton": NEWTON}
LEVELS = {"standard": 1, "lagged": 4}  # steps that share A, and its factors while as many rows hold
