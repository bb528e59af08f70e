"""The report for people: `report.html` and its pictures."""
