"""How long `newton` took before steps shared matrices and factors: commit 06c4596, kept as numbers."""

from __future__ import annotations

BEFORE = {
    (350, "limits", "air"): 0.200,
    (350, "limits", "press"): 0.191,
    (350, "limits", "slide"): 0.125,
    (350, "limited", "air"): 0.189,
    (350, "limited", "press"): 0.299,
    (350, "limited", "slide"): 0.187,
    (350, "no limits", "air"): 0.188,
    (350, "no limits", "press"): 0.134,
    (350, "no limits", "slide"): 0.076,
}
"""Size, scene, phase: its median over that of MuJoCo 4.0 at 350 tetrahedra, in the same phase of one run of `bench`.

Machines differ by less in such a ratio than in a time. Single repetitions were 0.6 to 1.4 of these.
"""
