"""The report: `report.html` and its figures."""
