"""Image pairs made from formulas, whose displacement is known exactly."""
