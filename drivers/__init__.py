"""Scanner and base: the interfaces, the wire to their computers, and the drivers behind them."""
