"""What every room may use: units, records, settings, errors, files, plug-ins, compiled code."""
