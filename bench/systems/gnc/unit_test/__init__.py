"""Ten items of a module, asked by command and judged."""
