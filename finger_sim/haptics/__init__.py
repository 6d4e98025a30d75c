"""The hand's side of the loop: command to bone, what a device renders, passivity, budgets of time."""
