"""What steps do, counted: that a scene's missing parts are not entered shows here, whatever a clock says."""

from __future__ import annotations

WORK = (
    "linear steps",
    "matrices",
    "factorisations",
    "singular value decompositions",
    "limits looked at",
    "limit rows",
    "nodes looked at for contact",
    "contact rows",
    "friction corrections",
)
"""Names of the counters in State.work."""
LINEAR, MATRICES, FACTORISATIONS, DECOMPOSITIONS, LIMITS_SEEN, LIMITS, NODES_SEEN, CONTACT_ROWS, CORRECTIONS = range(9)
