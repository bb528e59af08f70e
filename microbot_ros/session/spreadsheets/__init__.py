"""Import of laboratory files as sessions: spreadsheets, wide tables, pixels, intervals."""
