"""``bench plan``: the shortest sequence that reaches an uncertainty."""
