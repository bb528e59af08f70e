"""What my laboratory adds to microbot_ros."""
