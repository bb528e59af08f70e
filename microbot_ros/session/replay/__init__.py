"""Playing a session, replaying what nodes took in, and comparing recordings."""
