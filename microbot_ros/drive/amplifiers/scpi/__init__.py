"""SCPI: Kepco BOP bipolar supplies, one line per coil."""
