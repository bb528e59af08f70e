"""Shared basis of all rooms: units, records, settings, errors, files, plug-ins, compiled code."""
