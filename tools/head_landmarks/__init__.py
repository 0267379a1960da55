"""Makes the network that finds the head model's landmarks in photos."""
