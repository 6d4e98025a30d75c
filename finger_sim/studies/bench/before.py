"""How long `newton` took before steps shared matrices and factors: commit 06c4596, kept as numbers."""

from __future__ import annotations

BEFORE = {
    (350, "limits", "air"): 0.204,
    (350, "limits", "press"): 0.264,
    (350, "limits", "slide"): 0.156,
    (350, "limited", "air"): 0.205,
    (350, "limited", "press"): 0.374,
    (350, "limited", "slide"): 0.211,
    (350, "no limits", "air"): 0.191,
    (350, "no limits", "press"): 0.143,
    (350, "no limits", "slide"): 0.083,
}
"""Size, scene, phase: its median over that of MuJoCo 4.0 at 350 tetrahedra, in the same phase of one run of `bench`.

Measured on an Intel Xeon with AVX-512, 2026-11-30. On another kind of processor the ratio is another one: on an AMD
EPYC it was 0.200, 0.191 and 0.125 with limits. There `before` says little; run both commits in turn.
"""
