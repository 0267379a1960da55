"""Files of recorded performances: ARKit JSON, Live Link Face CSV, FLAME npz. `repair` is what the readers share."""
