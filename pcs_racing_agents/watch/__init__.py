"""The race viewer: one page that lists the races of a tournament and plays them."""
