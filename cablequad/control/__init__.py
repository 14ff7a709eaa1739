"""What decides: references, estimator, LQR design and the control laws."""
