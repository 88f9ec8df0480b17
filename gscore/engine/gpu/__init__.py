"""GPU engine: training on a graphics card through the library for them."""
