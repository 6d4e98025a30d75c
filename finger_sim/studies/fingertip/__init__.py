"""Does a finger press, shear and spread as fingertips are known to? `finger_sim figures --only fingertip`."""
