"""Make pictures that teach the photo parser, train it, hold it against drawn masks: see `__main__`."""
