"""Playing a session, replaying the inputs of nodes, and comparing recordings."""
