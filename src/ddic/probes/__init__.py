"""Virtual gauges on measured fields: points, lines, extensometers, strain gauges, and tables of what they read."""
