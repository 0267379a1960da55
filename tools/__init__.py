"""Scripts that rebuild committed assets, build the extension, and the demonstration. Not part of any package."""
