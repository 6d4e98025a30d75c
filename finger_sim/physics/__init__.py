"""The finger's mechanics, stage by stage: nothing here knows of ROS, files or scenes' text.

Letters (the paper's, where it has them; its G is our F):

| letter | meaning | unit |
|---|---|---|
| `X`, `x`, `v` | rest position, position, velocity of the nodes, (n, 3), world axes unless said | m, m, m/s |
| `F` | deformation gradient of a tetrahedron in its material axes, (3, 3) | 1 |
| `U s V` | signed singular value decomposition F = U diag(s) Vᵀ, det U = det V = +1 | 1 |
| `R` | rotation of the polar decomposition, R = U Vᵀ | 1 |
| `P` | first Piola-Kirchhoff stress | Pa |
| `C`, `J` | row function (C ≥ 0 is allowed) and its gradient ∂C/∂x | 1, 1/m (limits); m, 1 (contact) |
| `lam` | row force λ ≥ 0, generalised force is Jᵀλ | N m (limits), N (contact) |
| `phi` | gap of a node above the plane, negative inside it | m |
| `W` | Delassus matrix h² J A⁻¹ Jᵀ + compliance | |
| `h` | time step | s |
| `lame_mu`, `lame_lambda` | Lamé parameters | Pa |
| `mu_friction` | Coulomb coefficient | 1 |
"""
