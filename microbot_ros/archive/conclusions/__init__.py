"""What an archive says as a whole: spread, trends, recurring effects, report."""
