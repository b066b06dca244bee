"""Style of pictures, and learning curves."""
