"""The loop as one function of a frame: tracker, model, controller, allocation and gate."""
