"""Training data: the capture format, claims on jobs, and readers that turn foreign data sets into the same types."""
