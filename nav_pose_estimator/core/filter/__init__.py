"""The navigation filter: strapdown integration, error model, Kalman corrections, memory, mixtures."""
