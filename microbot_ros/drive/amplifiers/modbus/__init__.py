"""Modbus RTU: four H-bridges on one line."""
