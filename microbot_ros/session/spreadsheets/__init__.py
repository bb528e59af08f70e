"""What laboratories have, turned into sessions: spreadsheets, wide tables, pixels, intervals."""
