"""Sessions as folders of CSV files."""
