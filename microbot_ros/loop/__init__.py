"""The closed loop as a function of a frame: tracker, model, controller, allocation and gate."""
