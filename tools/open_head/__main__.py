"""`python -m tools.open_head`: rebuild the committed asset."""

from .build import main

main()
