"""What a scene chooses between, by number, as compiled code knows it: solvers, their levels, projections of limits."""

PGS, NEWTON = 0, 1
METHODS = {"pgs": PGS, "newton": NEWTON}
LEVELS = {"standard": 0.0, "lagged": 0.02}  # angle that a tetrahedron may turn by while steps share A [rad]; 0: none do

NONE, HYPERBOLIC, ISOTROPIC, TENSOR, ORTHOGONAL, LINEAR = range(6)
PROJECTIONS = {
    "hyperbolic": HYPERBOLIC,
    "isotropic": ISOTROPIC,
    "tensor": TENSOR,
    "orthogonal": ORTHOGONAL,
    "linear": LINEAR,
}
"""See strain_limits.py and tensor_limit.py; NONE: no limits."""
