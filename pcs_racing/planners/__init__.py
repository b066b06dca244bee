"""Policy families: motion planners that drive a car inside the compiled race."""
