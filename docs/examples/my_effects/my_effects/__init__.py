"""What my laboratory suspects."""
