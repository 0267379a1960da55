"""Hair as strands: `groom` holds them, `roots` carries them on a moving head. Numpy only.

The capture studio makes grooms and renders them; what draws or simulates hair reads the same record.
"""
